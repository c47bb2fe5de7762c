"""Jobs of a stress run: a section for one method or for the suite, run once and then reused.

Results of finished jobs lie in one JSON file a job, so that a stopped run resumes. They count as
long as the hash of all that they depend on is the same.
"""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch

from rlbench import registry
from rlbench.checks.result import CheckResult, Limits, Verdict, not_applicable
from rlbench.checks.stress.section import (
    StressedMethod,
    SuiteSection,
    list_sections,
    load_section,
    load_stressed_method,
    report_exception,
    unavailable_reason,
)
from rlbench.parallel.executor import LOCAL, Executor, ProgressCallback
from rlbench.parallel.process_executor import ProcessExecutor
from rlbench.system import code_hash, paths, provenance, store

_logger = logging.getLogger(__name__)

RUN = "run"  # name of the test that a section could not finish, or could not begin
PROCESSES = 2  # at once; a method at 1080p takes up to 4 GB
FRAME = ("rlbench.checks.stress.jobs", "rlbench.checks.stress.section")  # code of all sections
HASH_LENGTH = 16  # hex digits
SCHEMA = 2  # of stored results


@dataclass(frozen=True)
class StressJob:
    """A section to run."""

    section: str
    method: str  # name of the row, or "" for a section of the suite
    is_quick: bool
    device: str
    weights: str | None = field(default=None, repr=False)  # a file in place of the shipped one

    @property
    def title(self) -> str:
        """Method and section, as printed."""
        return f"{self.method}: {self.section}" if self.method else self.section


@dataclass(frozen=True)
class FinishedJob:
    """A job with its results."""

    job: StressJob
    results: tuple[CheckResult, ...]
    is_stored: bool = False  # True if an earlier run measured them
    is_complete: bool = True  # False if an exception ended it


def plan_jobs(
    methods: Sequence[str],
    sections: Sequence[str],
    is_quick: bool,
    device: torch.device,
    weights: Mapping[str, str] = MappingProxyType({}),
) -> list[StressJob]:
    """The jobs of a run: sections of the suite first, then method by method.

    `weights` are files by method, in place of the shipped ones.
    """
    of_suite = [name for name in sections if is_for_suite(name)]
    pairs = [("", name) for name in of_suite]
    pairs += [(method, name) for method in methods for name in sections if name not in of_suite]
    return [
        StressJob(section, method, is_quick, str(device), weights.get(method))
        for method, section in pairs
    ]


def is_for_suite(section: str) -> bool:
    """True for a section of the suite. One that cannot be imported fails once, not per method."""
    try:
        return isinstance(load_section(section), SuiteSection)
    except Exception:  # reported by its job
        return True


def default_executor(device: torch.device, job_count: int) -> Executor:
    """Two processes where there are two cores and the device is no GPU, else this process."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux only
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    is_parallel = device.type == "cpu" and min(cores, job_count) >= PROCESSES
    return ProcessExecutor(PROCESSES) if is_parallel else LOCAL


def run_jobs(
    jobs: Sequence[StressJob],
    folder: Path,
    executor: Executor = LOCAL,
    is_restart: bool = False,
) -> Iterator[FinishedJob]:
    """The results of each job as it finishes; stored ones first.

    `is_restart` runs all jobs again. A job that an exception ended is not stored.
    """
    hashes = {job: content_hash(job) for job in jobs}
    missing = []
    for job in jobs:
        if failure := registry.import_failure(job.method):
            yield _fail(job, failure)
            continue
        results = None if is_restart else read_results(folder, job, hashes[job])
        if results is None:
            missing.append(job)
        else:
            _logger.info("%s: in the results already", job.title)
            yield FinishedJob(job, results, is_stored=True)
    for outcome in executor.map(_SectionWork(), missing):
        job, error = outcome.job, outcome.error  # a job may have ended its process
        finished = outcome.result() if error is None else _fail(job, error)
        if finished.is_complete:
            write_results(folder, job, hashes[job], finished.results)
        yield finished


@dataclass
class _SectionWork:
    """Runs jobs. Keeps the last method, since its sections follow each other."""

    _method: StressedMethod | None = field(default=None, repr=False)

    def __call__(self, job: StressJob, on_progress: ProgressCallback) -> FinishedJob:
        """All results of a job; an exception of the method or of the section is a failure."""
        results: list[CheckResult] = []
        try:
            with registry.exits_as_errors():  # here, so that the results before it are kept
                for result in self._run(job):  # a plain number, as it will be read back
                    results.append(replace(result, figure=float(result.figure)))
        except Exception as error:  # whatever a method raises is reported
            return _fail(job, error, results)
        return FinishedJob(job, tuple(results))

    def _run(self, job: StressJob) -> Iterator[CheckResult]:
        if job.method and (reason := unavailable_reason(job.method, job.weights)):
            yield not_applicable(RUN, reason)
            return
        section = load_section(job.section)
        if isinstance(section, SuiteSection):
            yield from section.run(job.is_quick)
        else:
            yield from section.run(self._load(job), job.is_quick)

    def _load(self, job: StressJob) -> StressedMethod:
        if self._method is None or self._method.name != job.method:
            self._method = None  # frees memory before the next one is loaded
            self._method = load_stressed_method(job.method, torch.device(job.device), job.weights)
        return self._method


def _fail(job: StressJob, error: BaseException, results: Sequence[CheckResult] = ()) -> FinishedJob:
    """A job that an exception ended after some results."""
    failure = report_exception(job.method, RUN, error, "correct the line that raised")
    return FinishedJob(job, (*results, failure), is_complete=False)


def result_row(job: StressJob, result: CheckResult) -> dict[str, Any]:
    """A result as a row of a table."""
    return {
        "method": job.method,
        "section": job.section,
        "test": result.check,
        "verdict": result.verdict.value,
        "figure": result.figure,
        "unit": result.limits.unit,
        "good": result.limits.good,
        "fair": result.limits.fair,
        "found": result.found,
        "remedy": result.remedy,
    }


def read_results(folder: Path, job: StressJob, content_hash: str) -> tuple[CheckResult, ...] | None:
    """The stored results of a job; None without them, or if they are of other content.

    A file that cannot be read is as if it were absent, since the job can run again.
    """
    try:
        stored = json.loads(_file(folder, job).read_text(encoding="utf-8"))
        if (stored["schema"], stored["content_hash"]) != (SCHEMA, content_hash):
            return None
        return tuple(map(_from_row, stored["results"]))
    except (OSError, ValueError, TypeError, KeyError):  # absent, cut off, or of another version
        return None


def write_results(
    folder: Path, job: StressJob, content_hash: str, results: Sequence[CheckResult]
) -> None:
    """Store the results of a job, in place of older ones."""
    rows = [result_row(job, result) for result in results]
    document = {"schema": SCHEMA, "content_hash": content_hash, "results": rows}
    store.write_text(
        paths.check_no_link(folder, _file(folder, job)), json.dumps(document, indent=1)
    )


def _from_row(row: dict[str, Any]) -> CheckResult:
    limits = Limits(row["good"], row["fair"], row["unit"])
    texts = row["found"], row["remedy"]
    return CheckResult(row["test"], Verdict(row["verdict"]), *texts, row["figure"], limits)


def _file(folder: Path, job: StressJob) -> Path:
    """Two jobs never share a file, whatever characters their names have."""
    key = sha256((repr(job) + (job.weights or "")).encode()).hexdigest()[:8]
    name = re.sub(r"[^\w.+-]", "-", f"{job.method or 'suite'}--{job.section}", flags=re.ASCII)
    return folder / "jobs" / f"{name}-{key}.json"


def content_hash(job: StressJob) -> str:
    """Hash of a job's section, method, code, weights and versions of packages."""
    module = list_sections()[job.section].partition(":")[0]
    content = (
        *(job.section, job.method, job.is_quick, job.device, provenance.versions()),
        _section_code(module),
        *(_method_content(job.method, job.weights) if job.method else (_metrics_code(),)),
    )
    return sha256(repr(content).encode()).hexdigest()[:HASH_LENGTH]


@lru_cache(maxsize=64)
def _section_code(module: str) -> str:
    return code_hash.code_hash(code_hash.import_closure(module), core=(*code_hash.CORE, *FRAME))


def _method_content(name: str, file: str | None) -> tuple[str, ...]:
    """Hashes of a method's code and weights, and versions of the packages that it requires."""
    variant, weights = registry.get_variant(name), ""
    path = Path(file) if file else registry.shipped_weights(name) if variant.learned else None
    if path and path.is_file():
        weights = sha256(path.read_bytes()).hexdigest()
    return registry.method_code_hash(name), weights, provenance.package_versions(variant.requires)


@lru_cache(maxsize=1)
def _metrics_code() -> str:
    """Hash of the installed metrics, which sections of the suite may call."""
    return registry.metrics_code_hash(registry.list_plugins("metrics"), ())
