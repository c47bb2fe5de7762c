"""Intervals: equal to scipy's, their units, pairs of frames, coverage, and power."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from reports.analysis.intervals import (
    interval_ends,
    interval_of,
    mean_with_interval,
    pair,
    smallest_resolvable,
    standardised_resolvable,
)

SKEWED = np.array([0.1, 0.2, 0.15, 0.4, 1.9, 0.3, 0.05, 0.6, 0.22])
DISTRIBUTIONS = {  # draws of units with mean 0 and deviation 1; skewness
    "normal (0)": lambda g, shape: g.normal(0, 1, shape),
    "gamma (0.7)": lambda g, shape: (g.gamma(8, 1, shape) - 8) / np.sqrt(8),
    "gamma (1)": lambda g, shape: (g.gamma(4, 1, shape) - 4) / 2,
}


def frames(clip_values, scene="city", frames=3, wobble=0.0):
    return pd.DataFrame(
        [
            {"scene": scene, "clip": f"c{i}", "frame": f, "value": value + wobble * (f - 1)}
            for i, value in enumerate(clip_values)
            for f in range(frames)
        ]
    )


@pytest.mark.parametrize("clips", [2, 8])
def test_the_interval_covers_the_truth(clips):
    g = np.random.default_rng(0)
    trials = [
        mean_with_interval(frames(g.normal(0.5, 1.0, clips), wobble=5.0), seed=i, draws=1000)
        for i in range(300)
    ]
    hits = sum(trial.low <= 0.5 <= trial.high for trial in trials)
    # 285 expected of 300 at 95 %; 4 standard errors of a binomial are 15
    assert 285 - 15 <= hits <= 300


@pytest.mark.slow
@pytest.mark.parametrize("units", [4, 8, 12, 16, 24, 48])
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_a_95_percent_interval_covers_the_truth_in_93_to_97_percent(name, units, record_property):
    values = DISTRIBUTIONS[name](np.random.default_rng(units), (units, 4000))
    low, high = interval_ends(values, draws=1000)
    share = float(((low <= 0) & (high >= 0)).mean())
    record_property(f"coverage, {name}, {units} units", share)
    # 4000 trials scatter by 0.3 %, so the bounds leave 1.5 standard errors for the estimate
    assert (0.915 if units == 8 else 0.925) <= share <= 0.975


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
    half = stats.t.ppf(0.975, 199) * scores.std(ddof=1) / math.sqrt(200)
    # ends of a bootstrap of 10,000 draws scatter by about 1 % of the half width
    ends = (estimate.high - estimate.mean, estimate.mean - estimate.low)
    assert ends == pytest.approx((half, half), rel=0.06)


def test_clips_are_resampled_not_frames_and_each_scene_weighs_the_same():
    few, many = (mean_with_interval(frames([0.0, 1.0, 2.0, 3.0], frames=n)) for n in (2, 200))
    assert (many.low, many.high) == pytest.approx((few.low, few.high))
    city, hall = frames([1.0, 1.0, 1.0]), frames([3.0], scene="hall")
    assert mean_with_interval(pd.concat([city, hall])).mean == pytest.approx(2.0)


def test_equal_seeds_give_equal_intervals():
    values = frames([0.03, 1.71, 5.29, 2.13, 7.57, 3.31, 1.07, 4.91])  # enough for the bootstrap
    assert mean_with_interval(values, seed=3) == mean_with_interval(values, seed=3)
    assert mean_with_interval(values, seed=3) != mean_with_interval(values, seed=4)


def test_one_clip_has_no_interval_and_is_no_tie():
    estimate = mean_with_interval(frames([1.0]))
    assert (estimate.mean, estimate.is_within(2.0), math.isnan(estimate.low)) == (1.0, False, True)


def test_pairs_are_matched_by_clip_and_frame_and_lose_what_both_methods_share():
    common = np.array([0.0, 10.0, -10.0, 5.0])  # effect of each clip on every method
    shuffled = frames(common, wobble=0.5).sample(frac=1, random_state=0)
    gaps = pair(frames(common + 0.1, wobble=0.5), shuffled)
    assert gaps["value"].tolist() == pytest.approx([0.1] * 12)
    gap = mean_with_interval(gaps)
    assert (gap.low, gap.high) == pytest.approx((0.1, 0.1))


def test_from_eight_units_on_the_interval_is_scipys_bca_at_hesterbergs_level():
    level = 1 - 2 * stats.norm.cdf(-math.sqrt(9 / 8) * stats.t.ppf(0.975, 8))
    generator = np.random.default_rng(5)
    expected = stats.bootstrap(
        (SKEWED,), np.mean, n_resamples=2000, confidence_level=level, method="BCa", rng=generator
    ).confidence_interval
    interval = interval_of(SKEWED, seed=5, draws=2000)
    # draws equal to the mean count by the rounding of their sum, which depends on the layout
    assert (interval.low, interval.high) == pytest.approx((expected.low, expected.high), rel=0.01)
    assert interval.high - interval.mean > 1.3 * (interval.mean - interval.low)  # it is skewed


@pytest.mark.parametrize("units", [SKEWED[:5], SKEWED])
def test_the_p_value_is_that_of_the_paired_t_test(units):
    expected = stats.ttest_1samp(units, 0.0).pvalue
    assert interval_of(units, draws=100).p_value == pytest.approx(expected)


@pytest.mark.parametrize(("value", "p_value"), [(0.5, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize("count", [4, 9])
def test_equal_units_have_an_interval_without_width(value, p_value, count):
    interval = interval_of(np.full(count, value))
    assert (interval.low, interval.high, interval.p_value) == (value, value, p_value)


@pytest.mark.parametrize("units", [3, 8, 12])
def test_intervals_of_many_columns_are_those_of_each(units):
    columns = np.random.default_rng(0).normal(size=(units, 70))
    low, high = interval_ends(columns, draws=500)
    for i in (0, 63, 64, 69):
        alone = [end[0] for end in interval_ends(columns[:, [i]], draws=500)]
        # BCa counts draws equal to the mean, by the rounding of their sum
        assert [low[i], high[i]] == pytest.approx(alone, rel=0.01)


def test_a_column_with_a_gap_has_no_interval_and_changes_no_other(recwarn):
    columns = np.random.default_rng(0).normal(size=(9, 3))
    expected = interval_ends(columns[:, [0, 2]], draws=200)
    columns[4, 1] = np.nan
    low, high = interval_ends(columns, draws=200)
    assert np.isnan([low[1], high[1]]).all()
    assert [*low[[0, 2]], *high[[0, 2]]] == pytest.approx([*expected[0], *expected[1]])
    assert not recwarn.list


@pytest.mark.parametrize(("effect", "units"), [(0.2, 199), (0.5, 34), (0.8, 15)])
def test_units_for_the_effects_of_cohen_are_those_of_published_tables(effect, units):
    """Sizes of a paired t-test at 5 % and power 80 % (G*Power 3.1, Faul et al. 2007)."""
    assert standardised_resolvable(units) <= effect < standardised_resolvable(units - 1)


@pytest.mark.parametrize("units", [3, 4, 6])
def test_a_resolvable_difference_is_resolved_in_four_of_five_trials(units):
    generator = np.random.default_rng(units)
    size = smallest_resolvable(0.3, units)
    low, _ = interval_ends(generator.normal(size, 0.3, (units, 2000)))
    assert np.mean(low > 0) == pytest.approx(0.8, abs=0.036)  # 4 standard errors of a binomial


def test_one_scene_resolves_nothing_that_could_be_stated():
    assert math.isnan(smallest_resolvable(0.3, 1))
