"""Intervals: they cover the truth as often as they say, and pairing is what makes them short."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t

from reports.analysis.intervals import interval, paired


def frames(clip_values, scene="city", frames=3, wobble=0.0):
    return pd.DataFrame(
        [
            {"scene": scene, "clip": f"c{i}", "frame": f, "value": value + wobble * (f - 1)}
            for i, value in enumerate(clip_values)
            for f in range(frames)
        ]
    )


@pytest.mark.parametrize("clips", [2, 3, 4, 5, 7, 8, 12])
def test_the_interval_covers_the_truth(clips):
    g = np.random.default_rng(0)
    trials = [
        interval(frames(g.normal(0.5, 1.0, clips), wobble=5.0), seed=i, draws=1000)
        for i in range(300)
    ]
    hits = sum(found.low <= 0.5 <= found.high for found in trials)
    # 285 expected of 300 at 95 %; 4 standard errors of a binomial are 15
    assert 285 - 15 <= hits <= 300


def test_clips_of_one_scene_are_no_other_scenes():
    """Four scenes of eight clips that are all alike say no more of a fifth than four clips do."""
    means = {"city": 0.0, "hall": 1.0, "ripples": 2.0, "temple": 3.0}
    many = pd.concat([frames([mean] * 8, scene) for scene, mean in means.items()])
    few = pd.concat([frames([mean], scene) for scene, mean in means.items()])
    assert interval(many) == interval(few)
    assert interval(few).units == 4


def test_the_interval_of_many_clips_is_that_of_students_t():
    scores = np.random.default_rng(1).normal(2.0, 1.0, 200)
    found = interval(frames(scores, frames=1))
    half = t.ppf(0.975, 199) * scores.std(ddof=1) / math.sqrt(200)
    # ends of a bootstrap of 10,000 draws scatter by about 1 % of the half width
    assert found.high - found.mean == pytest.approx(half, rel=0.06)
    assert found.mean - found.low == pytest.approx(half, rel=0.06)


def test_clips_are_drawn_and_not_frames():
    few = interval(frames([0.0, 1.0, 2.0, 3.0], frames=2))
    many = interval(frames([0.0, 1.0, 2.0, 3.0], frames=200))
    assert (many.low, many.high) == pytest.approx((few.low, few.high))


def test_each_scene_weighs_the_same():
    city, hall = frames([1.0, 1.0, 1.0]), frames([3.0], scene="hall")
    assert interval(pd.concat([city, hall])).mean == pytest.approx(2.0)


def test_a_seed_gives_the_same_interval_again():
    values = frames([0.0, 1.0, 5.0, 2.0, 7.0])
    assert interval(values, seed=3) == interval(values, seed=3)


def test_one_clip_has_no_interval_and_is_no_tie():
    found = interval(frames([1.0]))
    assert (found.mean, found.tie, math.isnan(found.low)) == (1.0, False, True)


def test_pairing_removes_what_methods_share():
    hard = np.array([0.0, 10.0, -10.0, 5.0])  # how hard each clip is for everyone
    gap = interval(paired(frames(hard + 0.1), frames(hard)))
    assert (gap.low, gap.high) == pytest.approx((0.1, 0.1))


def test_pairs_are_matched_by_clip_and_frame_not_by_row():
    ours, theirs = frames([1.0, 2.0], wobble=0.5), frames([0.0, 1.0], wobble=0.5)
    shuffled = theirs.sample(frac=1, random_state=0)
    assert paired(ours, shuffled)["value"].tolist() == [1.0] * 6


@pytest.mark.parametrize(
    ("differences", "tie"),
    [([0.0] * 8, True), ([-1.0, 1.0] * 4, True), ([0.9, 1.1] * 4, False)],
)
def test_a_tie_is_an_interval_that_holds_zero(differences, tie):
    assert interval(frames(differences)).tie is tie
