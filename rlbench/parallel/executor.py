"""Executors run independent jobs: in this process one after another, or until a time is over."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar, cast

from rlbench.errors import RlbenchError
from rlbench.registry.failure import keep_frames
from rlbench.registry.plugin_code import exits_as_errors

J = TypeVar("J")
R = TypeVar("R")
J_in = TypeVar("J_in", contravariant=True)
R_out = TypeVar("R_out", covariant=True)

ProgressCallback = Callable[[float], None]  # receives the work done since the previous call


class ExecutorError(RlbenchError, RuntimeError):
    """An executor that cannot run jobs, or a job that was lost with its worker."""


@dataclass(frozen=True)
class Resources:
    """The share of a machine that one job takes while it runs."""

    cpus: int = 1  # all CPUs on a machine with fewer
    gpus: int = 0


ONE_CPU = Resources()


@dataclass(frozen=True)
class JobResult(Generic[J, R]):
    """A finished job, with the value that its work returned or the error that it raised."""

    job: J
    value: R | None = None
    error: Exception | None = None

    def __getstate__(self) -> dict[str, object]:
        """The fields, to be pickled; the error keeps its lines, as tracebacks are not pickled."""
        if self.error:
            keep_frames(self.error)
        return self.__dict__

    def result(self) -> R:
        """The value. Raises the error of a job that failed."""
        if self.error:
            raise self.error
        return cast("R", self.value)


class Work(Protocol[J_in, R_out]):
    """The function applied to each job.

    Each process has a copy of it, which may cache what is expensive to set up.
    """

    def __call__(self, job: J_in, on_progress: ProgressCallback, /) -> R_out:
        """The value of a job; calls `on_progress` while it runs."""


def ignore_progress(done: float) -> None:
    """A progress callback that does nothing."""


class Executor(Protocol):
    """Runs jobs and yields the result of each as soon as it has finished."""

    @property
    def exclusive(self) -> bool:
        """Whether jobs never run at the same time, so that each may measure times."""

    @property
    def description(self) -> str:
        """Description of the machines that run the jobs; empty for this process."""

    def local_exclusive(self) -> Executor:
        """An executor for jobs that measure times: on this machine, one after another."""

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        resources: Resources = ONE_CPU,
        on_progress: ProgressCallback = ignore_progress,
    ) -> Iterator[JobResult[J, R]]:
        """Apply `work` to every job; yields one result for each, in the order of completion.

        A job that raises, or exits, does not stop the others. Raises ExecutorError if no job can be
        run.
        """


@dataclass(frozen=True)
class LocalExecutor:
    """Runs jobs in this process, each when its result is requested."""

    exclusive: bool = True
    description: str = ""

    def local_exclusive(self) -> LocalExecutor:
        """Itself."""
        return self

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        resources: Resources = ONE_CPU,
        on_progress: ProgressCallback = ignore_progress,
    ) -> Iterator[JobResult[J, R]]:
        """Apply `work` to every job; yields one result for each, in the order of the jobs.

        >>> def double(job, on_progress):
        ...     return 2 * job
        >>> [result.value for result in LocalExecutor().map(double, [1, 2])]
        [2, 4]
        """
        for job in jobs:
            try:
                with exits_as_errors():
                    value = work(job, on_progress)
            except Exception as error:  # of any type: it is the result of the job
                yield JobResult(job, error=error)
            else:
                yield JobResult(job, value)


LOCAL = LocalExecutor()


class OutOfTimeError(RlbenchError, RuntimeError):
    """A command that stopped because its time was over."""


@dataclass(frozen=True)
class TimeLimit:
    """Minutes from the moment at which this object is made."""

    minutes: float = math.inf
    _began: float = field(default_factory=time.monotonic, repr=False, compare=False)

    @property
    def minutes_left(self) -> float:
        """Minutes until the limit, at least 0."""
        return max(self.minutes - (time.monotonic() - self._began) / 60, 0.0)


@dataclass(frozen=True)
class TimeLimitedExecutor:
    """An executor that begins no job after the limit. Finished jobs are not lost."""

    limit: TimeLimit
    executor: Executor = LOCAL

    @property
    def exclusive(self) -> bool:
        """As of the executor."""
        return self.executor.exclusive

    @property
    def description(self) -> str:
        """As of the executor."""
        return self.executor.description

    def local_exclusive(self) -> Executor:
        """The executor's own, with the same limit."""
        return TimeLimitedExecutor(self.limit, self.executor.local_exclusive())

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        resources: Resources = ONE_CPU,
        on_progress: ProgressCallback = ignore_progress,
    ) -> Iterator[JobResult[J, R]]:
        """As of the executor. Raises OutOfTimeError after the job in which the time was over."""
        for done, result in enumerate(self.executor.map(work, jobs, resources, on_progress), 1):
            yield result
            if not self.limit.minutes_left and done < len(jobs):
                raise OutOfTimeError(
                    f"{self.limit.minutes:g} minutes are over, and {len(jobs) - done} of "
                    f"{len(jobs)} jobs are not done. The same command goes on from here"
                )
