"""Where jobs run: here, one after another, or beside one another on the workers of Ray."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from rlbench.errors import RlbenchError

J = TypeVar("J")
R = TypeVar("R")
J_in = TypeVar("J_in", contravariant=True)
R_out = TypeVar("R_out", covariant=True)

ProgressCallback = Callable[
    [float], None
]  # hears how much of the work has been done since it last heard


class EngineError(RlbenchError, RuntimeError):
    """An engine that cannot run jobs, or a job that no worker came back from."""


@dataclass(frozen=True)
class Resources:
    """What one job takes of a machine while it runs."""

    cpus: int = 1  # of a machine with fewer, all of them
    gpus: int = 0


ONE = Resources()


@dataclass(frozen=True)
class JobResult(Generic[J, R]):
    """What became of one job."""

    job: J
    made: tuple[R, ...] = ()  # what the work returned, or nothing where it failed
    error: Exception | None = None

    def result(self) -> R:
        """What the work returned. Raises what the work raised."""
        if self.error:
            raise self.error
        return self.made[0]


class Work(Protocol[J_in, R_out]):
    """What is done to each job. Every process has a copy, which may keep what is dear to make."""

    def __call__(self, job: J_in, tell: ProgressCallback, /) -> R_out:
        """What is made of a job; `tell` hears of it on the way."""


class Executor(Protocol):
    """Runs jobs and hands back what became of each, as soon as it is there."""

    @property
    def exclusive(self) -> bool:
        """Does no job run beside another one, so that each may take times?"""

    @property
    def where(self) -> str:
        """Who runs the jobs, in words, or empty where it is this process."""

    def local_exclusive(self) -> Executor:
        """The same on this machine, one job after another, so that each may take times."""

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        share: Resources = ONE,
        tell: ProgressCallback = lambda done: None,
    ) -> Iterator[JobResult[J, R]]:
        """One outcome for each job, in the order in which they end.

        A job that raises does not stop the others. Raises EngineError where no job can be run.
        """


@dataclass(frozen=True)
class Local:
    """Runs jobs in this process, each when its outcome is asked for."""

    exclusive: bool = True
    where: str = ""

    def local_exclusive(self) -> Local:
        """Itself."""
        return self

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        share: Resources = ONE,
        tell: ProgressCallback = lambda done: None,
    ) -> Iterator[JobResult[J, R]]:
        """One outcome for each job, in the order of the jobs."""
        for job in jobs:
            try:
                made = work(job, tell)
            except Exception as error:  # of whatever kind: it is the outcome
                yield JobResult(job, error=error)
            else:
                yield JobResult(job, (made,))


LOCAL = Local()
