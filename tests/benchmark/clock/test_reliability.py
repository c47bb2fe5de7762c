"""The interval of a median against its definition, and the frames that means are of."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from rlbench.benchmark.latency import half_width, is_steady, median_ranks, middle_half


@pytest.mark.parametrize("count", [6, 7, 12, 40, 90, 300])
def test_the_ranks_are_the_narrowest_that_hold_the_median_with_95_percent(count):
    low, high = median_ranks(count)
    miss = 2 * stats.binom.cdf(low, count, 0.5)
    assert miss <= 0.05 < 2 * stats.binom.cdf(low + 1, count, 0.5)
    assert high == count - 1 - low


@pytest.mark.parametrize("count", [0, 1, 5])
def test_few_values_have_no_interval(count):
    assert median_ranks(count) is None
    assert math.isinf(half_width([1.0] * count))


@given(st.lists(st.floats(1, 1000), min_size=6, max_size=60))
def test_the_interval_scales_with_the_times(times):
    assert half_width([3 * time for time in times]) == pytest.approx(3 * half_width(times))


def test_microseconds_need_no_two_percent():
    assert is_steady([0.01, 0.02, 0.03, 0.04, 0.05, 0.06])
    assert not is_steady([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])


@pytest.mark.parametrize(("count", "kept"), [(1, 1), (3, 3), (4, 2), (12, 6), (13, 7)])
def test_the_middle_half_drops_a_quarter_at_each_end(count, kept):
    middle = middle_half(list(range(count)))
    assert len(middle) == kept
    assert sum(middle) / kept == (count - 1) / 2
