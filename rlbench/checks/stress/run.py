"""Stress methods, print the verdicts and write them as tables: the command `rlbench stress`."""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import torch
from rich.console import Console

from rlbench import registry
from rlbench.checks.console import print_lines
from rlbench.checks.result import Verdict
from rlbench.checks.stress.jobs import (
    FinishedJob,
    StressJob,
    default_executor,
    is_for_suite,
    plan_jobs,
    result_row,
    run_jobs,
)
from rlbench.checks.stress.section import select_sections
from rlbench.system import paths, provenance
from rlbench.system.folder_lock import locked_folder
from rlbench.system.progress import is_shown

VERDICT_NAMES = {
    Verdict.PASSED: "passed",
    Verdict.WARNING: "degraded",
    Verdict.FAILED: "failed",
    Verdict.SKIPPED: "skipped",
}
BAD_PIXEL = "bad-pixel"  # the section that plants one bad pixel per test
COLUMNS = (
    *("method", "section", "test", "verdict", "figure", "unit", "good", "fair"),
    *("found", "remedy"),
)  # of the tables
PIXELS = "pixels"  # unit of the figure of these tests: the pixels that it changed


def stress_methods(
    patterns: Sequence[str],
    sections: Sequence[str],
    is_quick: bool,
    device: torch.device,
    out: Path,
    is_restart: bool = False,
    weights: Callable[[Sequence[str]], Mapping[str, str]] = lambda names: {},
) -> bool:
    """Run sections on the selected methods, print the results and write them to `out`.

    No pattern selects all pretrained rows that have weights of their own or none, no section all
    sections; with patterns, those of the suite run only if they are named.
    `weights` gives a file for those of the selected methods that do not take their shipped one.
    Returns False if a test failed, or if `all` left out a family that cannot be imported. Raises
    PluginError for an unknown method, OptionError for an unknown section, and FolderInUseError
    where another process writes to `out`.
    """
    broken: list[str] = []
    rows_of = ["all/*" if pattern == "all" else pattern for pattern in patterns or ["all"]]
    methods = registry.expand(rows_of, on_skip=broken.append)
    if not patterns:  # rows that share weights behave alike, and a full run has ten minutes
        methods = [name for name in methods if registry.get_variant(name).weights_from is None]
    selected = select_sections(sections)
    if patterns and not sections:  # the question is about methods, not about the suite
        selected = [name for name in selected if not is_for_suite(name)]
    jobs = plan_jobs(methods, selected, is_quick, device, weights(methods))
    executor = default_executor(device, len(jobs))
    console, finished_jobs = Console(), dict[StressJob, FinishedJob]()
    with locked_folder(out):
        for finished in run_jobs(jobs, out, executor, is_restart):
            finished_jobs[finished.job] = finished
            origin = ", from an earlier run" if finished.is_stored else ""
            if is_shown():
                title = f"[{len(finished_jobs)}/{len(jobs)}] {finished.job.title}"
                sys.stderr.write(f"{title}{origin}\n")
            print_lines(finished.results, console, finished.job.title)
        ordered = [finished_jobs[job] for job in jobs]
        files = write_tables(ordered, out, is_quick, str(device))
    for line in [*map(str, files), *(f"failed: {message}" for message in broken)]:
        console.print(line, highlight=False, soft_wrap=True, markup=False)
    return not print_summary(ordered, console) and not broken


def print_summary(finished: Sequence[FinishedJob], console: Console) -> int:
    """Print the number of results of each verdict, and of planted bad pixels that were contained.

    Returns the number of failed tests.
    """
    counts = Counter(result.verdict for job in finished for result in job.results)
    text = ", ".join(f"{name}: {counts[verdict]}" for verdict, name in VERDICT_NAMES.items())
    console.print(text, highlight=False, soft_wrap=True)
    planted, contained = count_contained(finished)
    if planted:
        text = f"planted bad pixels: {contained} of {planted} contained"
        console.print(text, highlight=False, soft_wrap=True)
    return counts[Verdict.FAILED]


def count_contained(finished: Sequence[FinishedJob]) -> tuple[int, int]:
    """The number of bad pixels that were planted, and of those whose test passed."""
    planted = [
        result.verdict
        for job in finished
        for result in job.results
        if job.job.section == BAD_PIXEL and result.limits.unit == PIXELS
    ]
    return len(planted), planted.count(Verdict.PASSED)


def write_tables(
    finished: Sequence[FinishedJob], folder: Path, is_quick: bool, device: str
) -> tuple[Path, Path]:
    """Write `stress.csv` and `stress.json`, one row a result; returns both files.

    A figure that is nan or infinite is empty or `inf` in the CSV and null in the JSON.
    """
    table, document = folder / "stress.csv", folder / "stress.json"
    rows: list[dict[str, Any]] = [
        {**result_row(each.job, result), "verdict": VERDICT_NAMES[result.verdict]}
        for each in finished
        for result in each.results
    ]
    with (
        paths.atomic_write(table) as unfinished,
        unfinished.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(
            {name: "" if value != value else value for name, value in row.items()} for row in rows
        )
    content = {"quick": is_quick, "device": device, "versions": provenance.versions()}
    with paths.atomic_write(document) as unfinished:
        encoded = msgspec.json.encode({**content, "results": rows})
        unfinished.write_bytes(msgspec.json.format(encoded, indent=1) + b"\n")
    return table, document
