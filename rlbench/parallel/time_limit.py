"""A limit on the time of a command, which an executor keeps between two jobs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from rlbench.errors import RlbenchError
from rlbench.parallel.executor import (
    LOCAL,
    ONE_CPU,
    Executor,
    JobResult,
    ProgressCallback,
    Resources,
    Work,
    ignore_progress,
)

__all__ = ["OutOfTimeError", "TimeLimit", "TimeLimitedExecutor"]

J = TypeVar("J")
R = TypeVar("R")


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
