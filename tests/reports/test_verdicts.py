"""One definition of lead, tie and not resolved, in one wording."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from reports.analysis.intervals import Interval, interval_of
from reports.analysis.differences import describe_difference, name_verdict

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
def test_a_tie_is_an_interval_within_a_tenth_of_a_decibel(ends):
    assert name_verdict(interval(*ends), "dB") == CASES[ends]


@pytest.mark.parametrize("ends", CASES, ids=str)
def test_the_verdict_on_the_other_method_is_the_opposite(ends):
    opposite = {"leads": "trails", "trails": "leads"}
    other = name_verdict(interval(-ends[1], -ends[0]), "dB")
    assert other == opposite.get(CASES[ends], CASES[ends])


def test_other_units_have_no_ties_and_a_low_error_leads():
    assert name_verdict(interval(-0.04, 0.06), "") == "not resolved"
    assert name_verdict(interval(0.02, 0.06), "", "lower") == "trails"


@pytest.mark.parametrize("mean", [0.0, 0.02, 0.05, 0.09, 0.3])
@pytest.mark.parametrize("deviation", [0.01, 0.05, 0.1, 0.4])
def test_a_tie_is_what_two_one_sided_t_tests_at_2_5_percent_find(mean, deviation):
    units = mean + deviation * np.array([-1.2, -0.4, 0.5, 1.1, 0.0])
    smaller = stats.ttest_1samp(units, -0.1, alternative="greater").pvalue
    larger = stats.ttest_1samp(units, 0.1, alternative="less").pvalue
    is_tie = name_verdict(interval_of(units), "dB") == "tie"
    assert is_tie == (max(smaller, larger) <= 0.025)


@pytest.mark.parametrize("ends", CASES, ids=str)
def test_every_sentence_begins_with_its_verdict(ends):
    text = describe_difference(interval(*ends), "dB")
    assert text.startswith(CASES[ends] or "+nan dB, no interval")


def test_a_lead_is_stated_by_its_size_whatever_its_sign():
    gap = Interval(-0.2, -0.3, -0.1, 4)
    assert describe_difference(gap, "dB") == "trails by 0.20 dB [0.10, 0.30]"
    assert describe_difference(gap, "dB", "lower") == "leads by 0.20 dB [0.10, 0.30]"
