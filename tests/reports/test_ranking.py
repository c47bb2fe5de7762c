"""The best method, and the intervals of the differences to it."""

from __future__ import annotations

import pytest

from reports.analysis.aggregate import Scores
from reports.analysis.ranking import rank_methods
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import rows


def test_the_interval_of_one_scene_is_over_its_clips(results):
    ranks = rank_methods(Scores(results), draws=2000).set_index(["scene", "target_spp", "method"])
    row = ranks.loc[("city", 1.0, "ntas")]  # its two clips differ from ours by -1.36 and -1.24
    half = 12.7062 * 0.06  # Student's t of two
    assert (row["low"], row["high"]) == pytest.approx((-1.3 - half, -1.3 + half), rel=1e-4)


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
