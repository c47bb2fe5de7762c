"""Runs sections of the stress suite on methods, and reuses the results that are stored."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from rlbench import registry
from rlbench.checks.stress.job import RUN, JobOutcome, SectionWork, StressJob, report_exception
from rlbench.checks.stress.job_hash import content_hash
from rlbench.checks.stress.result import StressResult
from rlbench.checks.stress.result_store import ResultStore
from rlbench.checks.stress.section import SuiteSection
from rlbench.checks.stress.sections import load_section
from rlbench.parallel.executor import LOCAL, Executor, JobResult
from rlbench.parallel.process_executor import ProcessExecutor

__all__ = ["FinishedJob", "default_executor", "is_for_suite", "plan_jobs", "run_jobs"]

_logger = logging.getLogger(__name__)

PROCESSES = 2  # at once; a method at 1080p takes up to 4 GB


@dataclass(frozen=True)
class FinishedJob:
    """A job with its results."""

    job: StressJob
    results: tuple[StressResult, ...]
    is_stored: bool = False  # True if an earlier run measured them


def plan_jobs(
    methods: Sequence[str], sections: Sequence[str], is_quick: bool, device: torch.device
) -> list[StressJob]:
    """The jobs of a run: sections of the suite first, then method by method."""
    of_suite = [name for name in sections if is_for_suite(name)]
    pairs = [("", name) for name in of_suite]
    pairs += [(method, name) for method in methods for name in sections if name not in of_suite]
    return [StressJob(section, method, is_quick, str(device)) for method, section in pairs]


def run_jobs(
    jobs: Sequence[StressJob],
    folder: Path,
    executor: Executor = LOCAL,
    is_restart: bool = False,
) -> Iterator[FinishedJob]:
    """The results of each job as it finishes; stored ones first.

    `is_restart` runs all jobs again. A job that an exception ended is not stored.
    """
    store = ResultStore(folder)
    hashes = {job: content_hash(job) for job in jobs}
    missing = []
    for job in jobs:
        if failure := registry.import_failure(job.method):
            yield FinishedJob(job, (report_exception(job.method, job.section, RUN, failure),))
            continue
        results = None if is_restart else store.read(job, hashes[job])
        if results is None:
            missing.append(job)
        else:
            _logger.info("%s: in the results already", job.title)
            yield FinishedJob(job, results, is_stored=True)
    for finished in executor.map(SectionWork(), missing):
        outcome = _outcome(finished)
        if outcome.is_complete:
            store.write(finished.job, hashes[finished.job], outcome.results)
        yield FinishedJob(finished.job, outcome.results)


def default_executor(device: torch.device, job_count: int) -> Executor:
    """Two processes where there are two cores and the device is no GPU, else this process."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux only
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    is_parallel = device.type == "cpu" and min(cores, job_count) >= PROCESSES
    return ProcessExecutor(PROCESSES) if is_parallel else LOCAL


def _outcome(finished: JobResult[StressJob, JobOutcome]) -> JobOutcome:
    """The outcome of a job, also of one that ended its process."""
    job = finished.job
    if finished.error is None:
        return finished.result()
    return JobOutcome(
        (report_exception(job.method, job.section, RUN, finished.error),), is_complete=False
    )


def is_for_suite(section: str) -> bool:
    """Is it a section of the suite? One that cannot be imported fails once, not per method."""
    try:
        return isinstance(load_section(section), SuiteSection)
    except Exception:  # reported by its job
        return True
