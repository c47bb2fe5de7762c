"""One job of a stress run: a section, for one method or for the suite."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch

import rlbench
from rlbench import registry
from rlbench.checks.result import Verdict
from rlbench.checks.stress.methods import load_stressed_method, unavailable_reason
from rlbench.checks.stress.result import StressResult, skip
from rlbench.checks.stress.section import StressedMethod, SuiteSection
from rlbench.checks.stress.sections import load_section
from rlbench.errors import RlbenchError
from rlbench.parallel.executor import ProgressCallback

__all__ = ["RUN", "JobOutcome", "SectionWork", "StressJob", "report_exception"]

RUN = "run"  # name of the test that a section could not finish, or could not begin


@dataclass(frozen=True)
class StressJob:
    """A section to run."""

    section: str
    method: str  # name of the row, or "" for a section of the suite
    is_quick: bool
    device: str

    @property
    def title(self) -> str:
        """Method and section, as printed."""
        return f"{self.method}: {self.section}" if self.method else self.section


@dataclass(frozen=True)
class JobOutcome:
    """The results of a job; it is complete unless an exception ended it."""

    results: tuple[StressResult, ...]
    is_complete: bool = True


@dataclass
class SectionWork:
    """Runs jobs. Keeps the last method, since its sections follow each other."""

    _method: StressedMethod | None = field(default=None, repr=False)

    def __call__(self, job: StressJob, on_progress: ProgressCallback) -> JobOutcome:
        """All results of a job; an exception of the method or of the section is a failure."""
        results: list[StressResult] = []
        try:
            with registry.exits_as_errors():  # here, so that the results before it are kept
                results.extend(map(_with_float, self._run(job)))
        except Exception as error:  # whatever a method raises is reported
            results.append(report_exception(job.method, job.section, RUN, error))
            return JobOutcome(tuple(results), is_complete=False)
        return JobOutcome(tuple(results))

    def _run(self, job: StressJob) -> Iterator[StressResult]:
        if job.method and (reason := unavailable_reason(job.method)):
            yield skip(job.method, job.section, RUN, reason)
            return
        section = load_section(job.section)
        if isinstance(section, SuiteSection):
            yield from section.run(job.is_quick)
        else:
            yield from section.run(self._load(job), job.is_quick)

    def _load(self, job: StressJob) -> StressedMethod:
        if self._method is None or self._method.name != job.method:
            self._method = None  # frees memory before the next one is loaded
            self._method = load_stressed_method(job.method, torch.device(job.device))
        return self._method


def _with_float(result: StressResult) -> StressResult:
    """The result with a plain number as its figure, as it will be read back."""
    return replace(result, figure=float(result.figure))


def report_exception(method: str, section: str, test: str, error: BaseException) -> StressResult:
    """The failure of a test that raised an exception; names the line that raised it.

    This is the method's own line, if the exception passed through one; else, unless the message
    says what to do, the suite's.
    """
    suite = [] if isinstance(error, RlbenchError) else [Path(rlbench.__file__).parent]
    found = f"raised {registry.failure_reason(method, error, *suite)}"
    remedy = "return a finite image for this input, without an exception"
    if isinstance(error, RlbenchError):
        remedy = ""
    elif test == RUN:
        remedy = "correct the line that raised"
    return StressResult(method, section, test, Verdict.FAILED, found=found, remedy=remedy)
