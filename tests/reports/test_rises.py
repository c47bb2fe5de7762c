"""The points of a curve whose times rise."""

from __future__ import annotations

import pytest

from reports.layout.curve_labels import longest_rise


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([], []),
        ([1.0, 2.0, 3.0], [0, 1, 2]),
        ([5.0, 2.0, 3.0], [1, 2]),
        ([1.0, 9.0, 3.0, 4.0], [0, 2, 3]),
        ([2.0, 2.0], [0, 1]),  # equal times do not run backwards
    ],
)
def test_the_longest_rise_is_kept(times, expected):
    assert longest_rise(times) == expected
