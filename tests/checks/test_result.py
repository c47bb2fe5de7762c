"""A check result as text, as a failing test, and as a line of the tick list."""

from __future__ import annotations

import pytest
from rich.console import Console

from rlbench.checks.console import print_results
from rlbench.checks.result import Limits, failed, judge, not_applicable, passed, warning

RESULTS = [
    passed("depth", "1 to 9"),
    warning("motion", "nothing moves", "set static = true"),
    failed("albedo", "found [0, 255]", "divide by 255"),
    not_applicable("temporal", "no state"),
]


def test_a_failed_result_raises_with_its_text_and_its_cause():
    cause = ZeroDivisionError("division by zero")
    with pytest.raises(AssertionError, match="budget: found 3 -> draw 4") as raised:
        failed("budget", "found 3", "draw 4", cause).raise_if_failed()
    assert raised.value.__cause__ is cause


@pytest.mark.parametrize("result", [RESULTS[0], RESULTS[1], RESULTS[3]])
def test_any_other_result_does_not_raise(result):
    result.raise_if_failed()


def test_each_result_has_one_line_with_its_mark_and_the_counts_follow():
    console = Console(record=True, width=40)
    figure = judge("drift", 2.1, Limits(1.0, 3.0, "dB"), "late", "forget")
    assert print_results([*RESULTS, figure], console, title="city") == [*RESULTS, figure]
    assert console.export_text().splitlines() == [
        "city",
        "  ✓ depth: 1 to 9",
        "  ! motion: nothing moves -> set static = true",
        "  ✗ albedo: found [0, 255] -> divide by 255",
        "  - temporal: no state",
        "  ! drift: 2.1 dB (passes up to 1, fails above 3), late -> forget",
        "  passed: 1, warning: 2, failed: 1, skipped: 1",
    ]


def test_a_line_is_printed_as_soon_as_its_result_is_there():
    console = Console(record=True)
    lines_before = []

    def results():
        for result in RESULTS:
            yield result
            lines_before.append(len(console.export_text(clear=False).splitlines()))

    print_results(results(), console)
    assert lines_before == [1, 2, 3, 4]
