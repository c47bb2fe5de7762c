"""The page of speed: a ratio for each library, of equal values."""

from __future__ import annotations

import re

import pytest

from tests.performance.metric_speed import AIMS, METRICS, OURS, page


@pytest.fixture(scope="module")
def rows():
    """Cells of the table by metric and library."""
    cells = re.findall(r"^\| (\S+, \S+) \S+ \| (.*) \|$", page(176, 176, rounds=2), re.MULTILINE)
    return {name: rest.split(" | ") for name, rest in cells}


def test_each_library_has_a_ratio_with_its_range_and_ours_has_none(rows):
    assert rows.keys() == {f"{metric}, {name}" for metric in METRICS for name in METRICS[metric]}
    for row, (_, ratio, aim, _) in rows.items():
        if row.endswith(OURS):
            assert ratio == aim == "-"
        else:
            middle, low, high = map(float, re.findall(r"[\d.]+", ratio))
            assert low <= middle <= high
            assert aim == f"{AIMS.get(row.split(', ')[1], '-')}".removesuffix(".0")


@pytest.mark.parametrize("metric", METRICS)
def test_the_values_of_pytorch_msssim_are_ours(rows, metric):
    own, other = (float(rows[f"{metric}, {name}"][-1]) for name in (OURS, "pytorch-msssim"))
    assert own == pytest.approx(other, abs=5e-5)  # float32, as in tests/metrics/test_ssim.py
