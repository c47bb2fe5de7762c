"""Intervals: equal to scipy's, their units, pairs of frames, and their verdicts' conditions."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.stats import t

from reports.analysis.intervals import interval_of, mean_with_interval, pair


def frames(clip_values, scene="city", frames=3, wobble=0.0):
    return pd.DataFrame(
        [
            {"scene": scene, "clip": f"c{i}", "frame": f, "value": value + wobble * (f - 1)}
            for i, value in enumerate(clip_values)
            for f in range(frames)
        ]
    )


@pytest.mark.parametrize("clips", [2, 4, 8])  # others in test_coverage
def test_the_interval_covers_the_truth(clips):
    g = np.random.default_rng(0)
    trials = [
        mean_with_interval(frames(g.normal(0.5, 1.0, clips), wobble=5.0), seed=i, draws=1000)
        for i in range(300)
    ]
    hits = sum(trial.low <= 0.5 <= trial.high for trial in trials)
    # 285 expected of 300 at 95 %; 4 standard errors of a binomial are 15
    assert 285 - 15 <= hits <= 300


def test_more_clips_of_a_scene_do_not_count_as_more_scenes():
    """Eight equal clips in each of four scenes give the interval of one clip in each."""
    means = {"city": 0.0, "hall": 1.0, "ripples": 2.0, "temple": 3.0}
    many = pd.concat([frames([mean] * 8, scene) for scene, mean in means.items()])
    few = pd.concat([frames([mean], scene) for scene, mean in means.items()])
    assert mean_with_interval(many) == mean_with_interval(few)
    assert mean_with_interval(few).units == 4


def test_the_interval_of_many_clips_is_close_to_students_t():
    scores = np.random.default_rng(1).normal(2.0, 1.0, 200)
    estimate = mean_with_interval(frames(scores, frames=1))
    half = t.ppf(0.975, 199) * scores.std(ddof=1) / math.sqrt(200)
    # ends of a bootstrap of 10,000 draws scatter by about 1 % of the half width
    assert estimate.high - estimate.mean == pytest.approx(half, rel=0.06)
    assert estimate.mean - estimate.low == pytest.approx(half, rel=0.06)


def test_clips_are_resampled_not_frames():
    few = mean_with_interval(frames([0.0, 1.0, 2.0, 3.0], frames=2))
    many = mean_with_interval(frames([0.0, 1.0, 2.0, 3.0], frames=200))
    assert (many.low, many.high) == pytest.approx((few.low, few.high))


def test_each_scene_weighs_the_same():
    city, hall = frames([1.0, 1.0, 1.0]), frames([3.0], scene="hall")
    assert mean_with_interval(pd.concat([city, hall])).mean == pytest.approx(2.0)


def test_equal_seeds_give_equal_intervals():
    values = frames([0.03, 1.71, 5.29, 2.13, 7.57, 3.31, 1.07, 4.91])  # enough for the bootstrap
    assert mean_with_interval(values, seed=3) == mean_with_interval(values, seed=3)
    assert mean_with_interval(values, seed=3) != mean_with_interval(values, seed=4)


def test_one_clip_has_no_interval_and_is_no_tie():
    estimate = mean_with_interval(frames([1.0]))
    assert (estimate.mean, estimate.is_within(2.0), math.isnan(estimate.low)) == (1.0, False, True)


def test_pairing_removes_what_is_common_to_both_methods():
    common = np.array([0.0, 10.0, -10.0, 5.0])  # effect of each clip on every method
    gap = mean_with_interval(pair(frames(common + 0.1), frames(common)))
    assert (gap.low, gap.high) == pytest.approx((0.1, 0.1))


def test_pairs_are_matched_by_clip_and_frame_not_by_row():
    ours, theirs = frames([1.0, 2.0], wobble=0.5), frames([0.0, 1.0], wobble=0.5)
    shuffled = theirs.sample(frac=1, random_state=0)
    assert pair(ours, shuffled)["value"].tolist() == [1.0] * 6


@pytest.mark.parametrize(
    ("differences", "is_resolved"),
    [([0.0] * 8, False), ([-1.0, 1.0] * 4, False), ([0.9, 1.1] * 4, True)],
)
def test_a_difference_is_resolved_if_its_interval_excludes_zero(differences, is_resolved):
    assert mean_with_interval(frames(differences)).excludes_zero is is_resolved


@pytest.mark.parametrize(
    ("differences", "is_tie"),
    [([-0.02, 0.02] * 4, True), ([0.05, 0.06] * 4, True), ([-1.0, 1.0] * 4, False)],
)
def test_a_tie_is_an_interval_within_the_margin(differences, is_tie):
    assert mean_with_interval(frames(differences)).is_within(0.1) is is_tie


SKEWED = np.array([0.1, 0.2, 0.15, 0.4, 1.9, 0.3, 0.05, 0.6, 0.22])


def test_from_eight_units_on_the_interval_is_scipys_bca_at_hesterbergs_level():
    level = 1 - 2 * stats.norm.cdf(-math.sqrt(9 / 8) * stats.t.ppf(0.975, 8))
    expected = stats.bootstrap(
        (SKEWED,),
        np.mean,
        n_resamples=2000,
        confidence_level=level,
        method="BCa",
        rng=np.random.default_rng(5),
    ).confidence_interval
    interval = interval_of(SKEWED, seed=5, draws=2000)
    # draws equal to the mean count by the rounding of their sum, which depends on the layout
    assert (interval.low, interval.high) == pytest.approx((expected.low, expected.high), rel=0.01)


@pytest.mark.parametrize("units", [SKEWED[:5], SKEWED])
def test_the_p_value_is_that_of_the_paired_t_test(units):
    expected = stats.ttest_1samp(units, 0.0).pvalue
    assert interval_of(units, draws=100).p_value == pytest.approx(expected)


@pytest.mark.parametrize(("value", "p_value"), [(0.5, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize("count", [4, 9])
def test_equal_units_have_an_interval_without_width(value, p_value, count):
    interval = interval_of(np.full(count, value))
    assert (interval.low, interval.high, interval.p_value) == (value, value, p_value)


def test_the_longer_end_of_a_skewed_interval_is_on_its_side():
    interval = interval_of(SKEWED)
    assert interval.high - interval.mean > 1.3 * (interval.mean - interval.low)
