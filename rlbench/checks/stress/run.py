"""Stress methods and print the verdicts: the command `rlbench stress`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from rich.console import Console

from rlbench import registry
from rlbench.checks.result import Verdict
from rlbench.checks.stress.console import print_job, print_summary
from rlbench.checks.stress.job import StressJob
from rlbench.checks.stress.result import StressResult
from rlbench.checks.stress.runner import default_executor, is_for_suite, plan_jobs, run_jobs
from rlbench.checks.stress.sections import select_sections
from rlbench.checks.stress.tables import write_tables
from rlbench.parallel.executor import Executor
from rlbench.system.folder_lock import locked_folder
from rlbench.system.progress import is_shown

__all__ = ["stress_methods"]


def stress_methods(
    patterns: Sequence[str],
    sections: Sequence[str],
    is_quick: bool,
    device: torch.device,
    out: Path,
    is_restart: bool = False,
    executor: Executor | None = None,
) -> bool:
    """Run sections on the selected methods, print the results and write them to `out`.

    No pattern selects all pretrained rows that have weights of their own or none, no section all
    sections; with patterns, those of the suite run only if they are named. Returns False if a test
    failed, or if `all` left out a family that cannot be imported. Raises PluginError for an unknown
    method, OptionError for an unknown section, and FolderInUseError where another process writes to
    `out`.
    """
    broken: list[str] = []
    rows_of = ["all/*" if pattern == "all" else pattern for pattern in patterns or ["all"]]
    methods = registry.expand(rows_of, on_skip=broken.append)
    if not patterns:  # rows that share weights behave alike, and a full run has ten minutes
        methods = [name for name in methods if registry.get_variant(name).weights_from is None]
    selected = select_sections(sections)
    if patterns and not sections:  # the question is about methods, not about the suite
        selected = [name for name in selected if not is_for_suite(name)]
    jobs = plan_jobs(methods, selected, is_quick, device)
    executor = executor or default_executor(device, len(jobs))
    console, results = Console(), dict[StressJob, tuple[StressResult, ...]]()
    with locked_folder(out):
        for finished in run_jobs(jobs, out, executor, is_restart):
            results[finished.job] = finished.results
            origin = ", from an earlier run" if finished.is_stored else ""
            if is_shown():
                sys.stderr.write(f"[{len(results)}/{len(jobs)}] {finished.job.title}{origin}\n")
            print_job(finished.job.title, finished.results, console)
        rows = [row for job in jobs for row in results[job]]
        files = write_tables(rows, out, is_quick, str(device))
    for line in [*map(str, files), *(f"failed: {message}" for message in broken)]:
        console.print(line, highlight=False, soft_wrap=True, markup=False)
    print_summary(rows, console)
    return not broken and all(row.verdict is not Verdict.FAILED for row in rows)
