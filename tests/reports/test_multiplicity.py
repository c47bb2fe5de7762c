"""Holm's correction: its step-down definition, its marks, and the sentences of a page."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from reports.analysis.intervals import interval_of
from reports.analysis.differences import (
    correct_by_holm,
    difference_columns,
    difference_notes,
    holm,
)

LEVELS = (0.001, 0.01, 0.05, 0.2)


def reject_step_down(p_values, level):
    """Holm's procedure as he states it: from the smallest p on, until one is not rejected."""
    rejected = [False] * len(p_values)
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    for rank, index in enumerate(order):
        if p_values[index] > level / (len(p_values) - rank):
            break
        rejected[index] = True
    return rejected


@pytest.mark.parametrize("seed", range(20))
def test_adjusted_values_reject_what_the_step_down_procedure_rejects(seed):
    generator = np.random.default_rng(seed)
    p_values = (generator.uniform(size=generator.integers(1, 12)) ** 3).round(3).tolist()
    for level in LEVELS:
        assert (holm(p_values) <= level).tolist() == reject_step_down(p_values, level)


def test_what_was_not_compared_does_not_count():
    assert holm([0.01, math.nan, 0.03])[[0, 2]].tolist() == holm([0.01, 0.03]).tolist()
    assert math.isnan(holm([math.nan])[0])


def records(*means):
    shape = np.array([-1.0, -0.3, 0.3, 1.0])
    return correct_by_holm(
        pd.DataFrame([difference_columns(interval_of(mean + 0.1 * shape)) for mean in means])
    )


def test_a_lead_that_the_correction_takes_away_is_marked():
    alone, among = records(0.2), records(0.2, *[0.0] * 9)
    assert alone["verdict"].tolist() == ["leads"]
    assert alone["mark"].tolist() == [""]
    assert among["verdict"].iloc[0] == "leads"
    assert among["mark"].tolist() == ["†", *[""] * 9]


def test_the_page_says_how_many_leads_are_kept_and_what_could_be_resolved():
    kept, sizes = difference_notes(records(5.0, 0.2, *[0.0] * 9))
    assert "for the 11 differences of this page keeps 1 of 2 leads" in kept
    # 0.1 x the deviation 0.853 of the shape x 2.128, for four units
    assert sizes.startswith("With power 80 %, these clips resolve differences from 0.18 dB")


def test_a_page_without_differences_says_nothing():
    assert difference_notes(records(1.0)[:0]) == []
