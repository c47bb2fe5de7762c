"""The best method, and the intervals of the differences to it."""

from __future__ import annotations

import pytest

from reports.analysis.scores import Scores
from reports.analysis.intervals import mean_with_interval, pair
from reports.analysis.ranking import rank_methods
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import rows


def test_the_interval_of_one_scene_is_over_its_clips(results):
    ranks = rank_methods(Scores(results), draws=2000).set_index(["scene", "target_spp", "method"])
    row = ranks.loc[("city", 1.0, "ntas")]  # its two clips differ from ours by -1.36 and -1.24
    half = 12.7062 * 0.06  # Student's t of two
    assert (row["low"], row["high"]) == pytest.approx((-1.3 - half, -1.3 + half), rel=1e-4)


def test_ranks_of_all_methods_are_those_of_pairs(results):
    scores = Scores(results)
    frames = scores.per_frame
    ranks = rank_methods(scores, draws=500)
    for row in ranks[~ranks["best"]].to_dict("records"):
        at = frames[frames["target_spp"] == row["target_spp"]]
        at = at if row["scene"] == "all" else at[at["scene"] == row["scene"]]
        best = ranks[ranks["best"] & (ranks["scene"] == row["scene"])]
        best = best[best["target_spp"] == row["target_spp"]]["method"].item()
        gap = pair(at[at["method"] == row["method"]], at[at["method"] == best])
        slow = mean_with_interval(gap, draws=500)
        # the means are added in another order
        fast = [row[name] for name in ("difference", "low", "high", "p_value")]
        assert fast == pytest.approx([slow.mean, slow.low, slow.high, slow.p_value], rel=1e-7)


def test_a_single_clip_has_no_interval_and_no_verdict():
    one = to_dataframe([r for r in rows(["ours", "ntas"]) if r.clip == "city-0"])
    ranks = rank_methods(Scores(one))
    assert ranks["low"].isna().all()
    assert (ranks["verdict"] == "").all()


def test_the_lowest_error_is_best(results):
    ranks = rank_methods(Scores(results, "relmse"), draws=100)
    best = ranks[ranks["best"] & (ranks["scene"] == "all")]
    assert best["method"].tolist() == ["ours"] * 5


def test_no_method_is_best_without_a_direction(results):
    scores = Scores(results.assign(direction=""))
    assert not rank_methods(scores, draws=100)["best"].any()
