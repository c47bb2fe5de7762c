"""In a worker process: the sender's settings, its plugins and code, and one job after another."""

from __future__ import annotations

import os
import platform
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from rlbench.parallel.executor import EngineError
from rlbench.registry import discovery
from rlbench.system import code_hash, provenance

PREFIX = "RLBENCH_"  # of the variables that a worker takes over
THREADS = f"{PREFIX}THREADS"  # of the path tracer
Unpickle = Callable[[bytes], Any]  # Ray's own, for what Ray itself has sent


@dataclass(frozen=True)
class WorkerEnvironment:
    """What the results of the sender depend on beside the job, for a worker to take over."""

    variables: dict[str, str]
    folder: str  # relative paths begin here
    search: tuple[str, ...]  # where modules are found
    plugins: tuple[Path, ...]
    torch_threads: int
    code: str  # see `code`

    def apply(self) -> None:
        """Make this process like the sender. Raises EngineError where its code is other code."""
        if code() != self.code:
            raise EngineError(
                f"{platform.node()} has {code()}, but the command was given where there is "
                f"{self.code}; install the same on both"
            )
        if os.path.isdir(self.folder):
            os.chdir(self.folder)
        for name in [name for name in os.environ if name.startswith(PREFIX)]:
            del os.environ[name]
        os.environ.update(self.variables)
        sys.path += [place for place in self.search if place not in sys.path]
        torch.set_num_threads(self.torch_threads)
        discovery.clear_plugins()
        for file in self.plugins:
            discovery.use_plugin(file)


@dataclass(frozen=True)
class TaskBundle:
    """Work as it is sent to workers, once for all of its jobs."""

    name: str  # no other parcel's
    setting: WorkerEnvironment
    work: bytes


@dataclass
class JobReply:
    """What comes back: what was made, or the error that was raised."""

    made: tuple[Any, ...] = ()
    error: Exception | None = None
    told: float = 0.0  # the sum of what the work told of its progress


@dataclass
class _Opened:
    """The work that this process has opened last, and goes on with."""

    name: str = ""
    work: Any = field(default=None, repr=False)


_opened = _Opened()


def setting(cpus: int) -> WorkerEnvironment:
    """This process's, for workers of which each has so many processors."""
    mine = {name: value for name, value in os.environ.items() if name.startswith(PREFIX)}
    return WorkerEnvironment(
        variables={THREADS: str(cpus), **mine},
        folder=os.getcwd(),
        search=tuple(os.path.abspath(place) for place in sys.path),
        plugins=discovery.loose_files(),
        torch_threads=torch.get_num_threads(),
        code=code(),
    )


def run(parcel: Callable[[], TaskBundle], name: str, job: bytes, loads: Unpickle) -> JobReply:
    """The answer to one job of the parcel called `name`, which is fetched if it is not open."""
    told: list[float] = []
    try:
        if _opened.name != name:
            _opened.name, _opened.work = "", None  # before the next one needs the memory
            got = parcel()
            got.setting.apply()
            _opened.name, _opened.work = name, loads(got.work)
        made = _opened.work(loads(job), told.append)
    except Exception as error:  # of whatever kind: the sender is told
        where = f"in a worker on {platform.node()}:\n{traceback.format_exc()}"
        error.add_note(where)
        return JobReply(error=error)
    return JobReply((made,), told=sum(told))


@lru_cache(maxsize=1)
def code() -> str:
    """Versions that decide results, and a hash of the code of rlbench and of installed plugins."""
    found = {e.target for group in discovery.GROUPS for e in discovery.installed(group)}
    tops = {"rlbench", *(target.partition(":")[0].partition(".")[0] for target in found)}
    versions = " ".join(f"{name} {version}" for name, version in provenance.versions().items())
    return f"{versions}, code {code_hash.code_hash(tops, core=())}"
