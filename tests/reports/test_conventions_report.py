"""The report on conventions: ranks and swaps of scores whose order is known."""

from __future__ import annotations

import itertools

import pandas as pd
import pytest

from reports import conventions
from reports.analysis.aggregate import Scores
from reports.analysis.convention_ranks import (
    conventions_by_metric,
    rank_agreement,
    rank_by_convention,
    swaps,
)
from rlbench.benchmark.results import MissingRowsError, Row, to_dataframe

SCENES = ("city", "hall", "temple", "ripples")
SRGB = {"a": 30.0, "b": 29.0, "c": 28.0, "d": 27.0}
HABLE = {"a": 31.0, "b": 33.0, "c": 28.5, "d": 28.4}  # b passes a
NOISE = (0.1, -0.1, 0.05, -0.05)  # dB of `b`, by scene


def table(by_metric, direction="higher", noise=NOISE):
    rows = []
    for (metric, values), (scene, offset) in itertools.product(
        by_metric.items(), zip(SCENES, noise, strict=True)
    ):
        for method, value in values.items():
            score = value + offset * (method == "b")
            rows += [
                Row(
                    "r1", method, scene, scene, 1.0, 1.0, frame, metric, score, "dB", direction,
                    f"convention of {metric}", device="CPU",
                )
                for frame in range(2)
            ]  # fmt: skip
    return to_dataframe(rows)


def scores_of(rows):
    (names,) = conventions_by_metric(rows).values()
    return {convention: Scores(rows, name) for convention, name in names.items()}


def test_ranks_are_by_mean_and_agreement_is_kendalls_tau():
    scores = scores_of(table({"psnr": SRGB, "psnr@hable": HABLE}))
    ranked = rank_by_convention(scores)
    ranks = ranked.pivot_table("rank", "method", "convention")
    assert ranks["srgb"].to_dict() == {"a": 1, "b": 2, "c": 3, "d": 4}
    assert ranks["hable"].to_dict() == {"a": 2, "b": 1, "c": 3, "d": 4}
    agreement = rank_agreement(ranked)
    assert agreement["tau"].tolist() == [pytest.approx((5 - 1) / 6)]  # 1 of 6 pairs is discordant


@pytest.mark.parametrize(("noise", "is_resolved"), [(NOISE, True), ((4.0, -4.0, 3.0, -3.0), False)])
def test_a_swap_is_resolved_if_both_intervals_exclude_zero(noise, is_resolved):
    scores = scores_of(table({"psnr": SRGB, "psnr@hable": HABLE}, noise=noise))
    (swap,) = swaps(scores, rank_by_convention(scores)).to_dict("records")
    assert (swap["first"], swap["second"]) == ("a", "b")
    assert (swap["convention"], swap["other"]) == ("srgb", "hable")
    assert swap["gap"] == pytest.approx(1.0)
    assert swap["other_gap"] == pytest.approx(-2.0)
    assert swap["low"] < swap["gap"] < swap["high"]
    assert swap["is_resolved"] == is_resolved


def test_where_lower_is_better_the_order_is_reversed():
    scores = scores_of(table({"mse": SRGB, "mse@hable": HABLE}, direction="lower"))
    ranked = rank_by_convention(scores)
    best = ranked[(ranked["convention"] == "srgb") & (ranked["rank"] == 1)]
    assert best["method"].tolist() == ["d"]
    (swap,) = swaps(scores, ranked).to_dict("records")
    assert (swap["first"], swap["second"]) == ("b", "a")  # 29 is better than 30


def test_a_method_without_a_convention_is_ranked_under_none():
    partial = {name: value for name, value in HABLE.items() if name != "c"}
    ranked = rank_by_convention(scores_of(table({"psnr": SRGB, "psnr@hable": partial})))
    assert set(ranked["method"]) == {"a", "b", "d"}


def test_the_page_has_scores_with_ranks_agreement_and_a_sentence_a_swap(tmp_path):
    rows = table({"psnr": SRGB, "psnr@hable": HABLE, "psnr@linear": SRGB})
    page, csv, tex = (file.read_text() for file in conventions.write(rows, tmp_path, draws=100))
    assert "| a | **30 (1)** | 31 (2) | **30 (1)** |" in page
    assert "| srgb | 0.67 | 1.00 |" in page
    assert "2 swaps, 2 of them resolved" in page
    assert "a leads b under srgb by +1 [" in page
    assert "hable: convention of psnr@hable" in page
    assert set(pd.read_csv(tmp_path / "conventions.csv")["table"]) == {"scores", "tau", "swap"}
    assert csv
    assert r"\begin{tabular}{lS[table-format=2.0]@{\,}lS" in tex


def test_conventions_that_agree_are_said_to_agree(tmp_path):
    rows = table({"psnr": SRGB, "psnr@linear": SRGB})
    page = conventions.write(rows, tmp_path)[0].read_text()
    assert "No pair of methods swaps places between any two conventions." in page


def test_results_of_one_convention_are_an_error_that_says_what_to_run(tmp_path):
    with pytest.raises(MissingRowsError, match="rlbench evaluate --convention"):
        conventions.write(table({"psnr": SRGB}), tmp_path)
