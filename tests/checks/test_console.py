"""The tick list on the terminal."""

from __future__ import annotations

from rich.console import Console

from rlbench.checks.console import print_results
from rlbench.checks.result import failed, not_applicable, passed, warning

RESULTS = [
    passed("depth", "1 to 9"),
    warning("motion", "nothing moves", "set static = true"),
    failed("albedo", "found [0, 255]", "divide by 255"),
    not_applicable("temporal", "no state"),
]


def test_each_result_has_one_line_with_its_mark_and_the_counts_follow():
    console = Console(record=True, width=40)
    assert not print_results(RESULTS, console, title="city")
    assert console.export_text().splitlines() == [
        "city",
        "  ✓ depth: 1 to 9",
        "  ! motion: nothing moves -> set static = true",
        "  ✗ albedo: found [0, 255] -> divide by 255",
        "  - temporal: no state",
        "  passed: 1, warning: 1, failed: 1, skipped: 1",
    ]


def test_warnings_and_skipped_checks_are_no_failure():
    assert print_results(RESULTS[:2] + RESULTS[3:], Console(quiet=True))


def test_a_line_is_printed_as_soon_as_its_result_is_there():
    console = Console(record=True)
    lines_before = []

    def results():
        for result in RESULTS:
            yield result
            lines_before.append(len(console.export_text(clear=False).splitlines()))

    print_results(results(), console)
    assert lines_before == [1, 2, 3, 4]
