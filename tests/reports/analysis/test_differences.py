"""One definition of lead, tie and not resolved; Holm's correction; the best and its rivals."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from reports.analysis.differences import (
    correct_by_holm,
    describe_difference,
    difference_columns,
    difference_notes,
    holm,
    name_verdict,
    rank_methods,
    subtract_base,
)
from reports.analysis.intervals import Interval, interval_of, mean_with_interval, pair
from reports.analysis.scores import Scores
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import rows

CASES = {  # ends of the interval in dB -> verdict
    (-0.04, 0.06): "tie",
    (0.02, 0.06): "tie",
    (-0.1, 0.1): "tie",
    (-0.05, 0.11): "not resolved",
    (-2.0, 2.0): "not resolved",
    (0.02, 0.3): "leads",
    (-0.3, -0.02): "trails",
    (math.nan, math.nan): "",
}


def interval(low, high):
    return Interval((low + high) / 2, low, high, 4)


@pytest.mark.parametrize("ends", CASES, ids=str)
def test_an_interval_has_one_verdict_and_the_other_method_the_opposite(ends):
    verdict = CASES[ends]
    assert name_verdict(interval(*ends), "dB") == verdict
    other = name_verdict(interval(-ends[1], -ends[0]), "dB")
    assert other == {"leads": "trails", "trails": "leads"}.get(verdict, verdict)
    text = describe_difference(interval(*ends), "dB")
    assert text.startswith(verdict or "+nan dB, no interval")


def test_other_units_have_no_ties_and_a_low_error_leads():
    assert name_verdict(interval(-0.04, 0.06), "") == "not resolved"
    assert name_verdict(interval(0.02, 0.06), "", "lower") == "trails"
    gap = Interval(-0.2, -0.3, -0.1, 4)
    assert describe_difference(gap, "dB", "lower") == "leads by 0.20 dB [0.10, 0.30]"


def test_a_tie_is_what_two_one_sided_t_tests_at_2_5_percent_find():
    for mean, deviation in product((0.0, 0.02, 0.05, 0.09, 0.3), (0.01, 0.05, 0.1, 0.4)):
        units = mean + deviation * np.array([-1.2, -0.4, 0.5, 1.1, 0.0])
        smaller = stats.ttest_1samp(units, -0.1, alternative="greater").pvalue
        larger = stats.ttest_1samp(units, 0.1, alternative="less").pvalue
        is_tie = name_verdict(interval_of(units), "dB") == "tie"
        assert is_tie == (max(smaller, larger) <= 0.025)


def reject_step_down(p_values, level):
    """Holm's procedure as he states it: from the smallest p on, until one is not rejected."""
    rejected = [False] * len(p_values)
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    for rank, index in enumerate(order):
        if p_values[index] > level / (len(p_values) - rank):
            break
        rejected[index] = True
    return rejected


@pytest.mark.parametrize("seed", range(5))
def test_adjusted_values_reject_what_the_step_down_procedure_rejects(seed):
    generator = np.random.default_rng(seed)
    p_values = (generator.uniform(size=generator.integers(1, 12)) ** 3).round(3).tolist()
    for level in (0.001, 0.01, 0.05, 0.2):
        assert (holm(p_values) <= level).tolist() == reject_step_down(p_values, level)


def test_what_was_not_compared_does_not_count():
    assert holm([0.01, math.nan, 0.03])[[0, 2]].tolist() == holm([0.01, 0.03]).tolist()
    assert math.isnan(holm([math.nan])[0])


def records(*means):
    shape = np.array([-1.0, -0.3, 0.3, 1.0])
    return correct_by_holm(
        pd.DataFrame([difference_columns(interval_of(mean + 0.1 * shape)) for mean in means])
    )


def test_a_lead_that_the_correction_takes_away_is_marked_and_counted():
    alone, among = records(0.2), records(0.2, *[0.0] * 9)
    assert alone[["verdict", "mark"]].to_numpy().tolist() == [["leads", ""]]
    assert among["verdict"].iloc[0] == "leads"
    assert among["mark"].tolist() == ["†", *[""] * 9]
    kept, sizes = difference_notes(records(5.0, 0.2, *[0.0] * 9))
    assert "for the 11 differences of this page keeps 1 of 2 leads" in kept
    # 0.1 x the deviation 0.853 of the shape x 2.128, for four units
    assert sizes.startswith("With power 80 %, these clips resolve differences from 0.18 dB")
    assert difference_notes(records(1.0)[:0]) == []


def test_ranks_of_all_methods_are_those_of_pairs(results):
    scores = Scores(results[results["target_spp"].isin([1, 4])])
    frames = scores.per_frame
    ranks = rank_methods(scores)
    for row in ranks[~ranks["best"]].to_dict("records"):
        at = frames[frames["target_spp"] == row["target_spp"]]
        at = at if row["scene"] == "all" else at[at["scene"] == row["scene"]]
        best = ranks[ranks["best"] & (ranks["scene"] == row["scene"])]
        best = best[best["target_spp"] == row["target_spp"]]["method"].item()
        slow = mean_with_interval(pair(at[at["method"] == row["method"]], at[at["method"] == best]))
        # the means are added in another order
        fast = [row[name] for name in ("difference", "low", "high", "p_value")]
        assert fast == pytest.approx([slow.mean, slow.low, slow.high, slow.p_value], rel=1e-7)


def test_a_single_clip_has_no_interval_and_no_verdict():
    ranks = rank_methods(Scores(to_dataframe(rows(["ours", "ntas"], clip="city-0"))))
    assert ranks["low"].isna().all()
    assert (ranks["verdict"] == "").all()


@pytest.mark.parametrize(("direction", "best"), [("lower", {"ours"}), ("", set())])
def test_the_lowest_error_is_best_and_nothing_without_a_direction(results, direction, best):
    ranks = rank_methods(Scores(results.assign(direction=direction), "relmse"))
    assert set(ranks.loc[ranks["best"] & (ranks["scene"] == "all"), "method"]) == best


def test_differences_to_a_base_are_those_of_the_formulas(results):
    gaps = subtract_base(Scores(results), "ours", ["ours/latent-small"]).set_index("target_spp")
    for spp, row in gaps.iterrows():
        assert row["difference"] == pytest.approx(29.2 - 29.9 + (1.1 - 1.15) * math.log2(spp))
        assert row["frame_ms"] == pytest.approx(2.2 + 4.5 - 5.5 - 11.0)
        assert (row["pairs"], row["unpaired"], row["units"]) == (4 * 2 * 4, 0, 4)


def test_the_interval_of_one_scene_is_over_its_clips():
    city = to_dataframe(rows(["ours", "ntas"], scene="city"))
    gap = subtract_base(Scores(city), "ours", ["ntas"]).set_index("target_spp").loc[1.0]
    half = 12.7062 * 0.06  # Student's t of its two clips, which have -1.36 and -1.24
    assert (gap["low"], gap["high"]) == pytest.approx((-1.3 - half, -1.3 + half), rel=1e-4)


def test_scores_of_one_seed_are_paired_and_others_left_out():
    """The seeds differ by 10 dB, the variants by 1 dB: every pair of one seed differs by 1 dB."""
    base = rows(["ours"], metric="psnr", target_spp=1)
    seeded = [replace(r, seed=s, value=10.0 * s) for r in base for s in (0, 1)]
    more = [replace(r, method="ours/A9", value=r.value + 1) for r in seeded]
    alone = [replace(r, seed=2, value=99.0) for r in more if r.seed == 0]
    row = subtract_base(Scores(to_dataframe([*seeded, *more, *alone])), "ours", ["ours/A9"]).iloc[0]
    assert (row["difference"], row["low"], row["high"]) == (1, 1, 1)
    assert (row["pairs"], row["unpaired"]) == (64, 32)
