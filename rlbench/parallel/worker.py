"""Runs jobs in a worker process, in the environment of the process that submitted them."""

from __future__ import annotations

import os
import platform
import sys
import sysconfig
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from rlbench.parallel.executor import ExecutorError
from rlbench.registry import (
    GROUPS,
    clear_plugins,
    discovery,
    exits_as_errors,
    plugin_files,
    use_plugin,
)
from rlbench.registry.failure import keep_frames
from rlbench.system import code_hash, provenance

__all__ = ["JobReply", "TaskBundle", "WorkerEnvironment", "code_version", "run_job"]

PREFIX = "RLBENCH_"  # of the environment variables that a worker takes over
THREADS = f"{PREFIX}THREADS"  # of the path tracer
Unpickle = Callable[[bytes], Any]  # Ray's own, for data that Ray itself has sent


@dataclass(frozen=True)
class WorkerEnvironment:
    """The submitter's settings on which results depend beside the job.

    Ray starts workers with `variables` (see `runtime_env`). The rest is applied in the worker,
    since Ray cannot: it copies a working directory, so that relative paths of outputs would be
    lost, it cannot unset a variable, and its set-up hook is the same for all jobs of a session.
    """

    variables: dict[str, str]
    folder: str  # the working directory
    plugins: tuple[Path, ...]  # files given with --plugin
    code_version: str  # see `code_version`

    @staticmethod
    def of_this_process(cpus: int) -> WorkerEnvironment:
        """The settings of this process, for workers with `cpus` CPUs each."""
        settings = {name: value for name, value in os.environ.items() if name.startswith(PREFIX)}
        return WorkerEnvironment(
            variables={
                THREADS: str(cpus),
                "OMP_NUM_THREADS": str(torch.get_num_threads()),  # of torch, in the worker
                "PYTHONPATH": os.pathsep.join(_module_folders()),
                **settings,
            },
            folder=os.getcwd(),
            plugins=plugin_files.plugin_files(),
            code_version=code_version(),
        )

    def runtime_env(self) -> dict[str, Any]:
        """The part that Ray sets when it starts a worker."""
        return {"env_vars": self.variables}

    def apply(self) -> None:
        """Set the rest in this process. Raises ExecutorError if its code is another version."""
        if code_version() != self.code_version:
            raise ExecutorError(
                f"{platform.node()} has {code_version()}, but the command was given on a machine "
                f"with {self.code_version}. Install the same version on both"
            )
        if os.path.isdir(self.folder):
            os.chdir(self.folder)
        for name in [name for name in os.environ if name.startswith(PREFIX)]:
            if name not in self.variables:
                del os.environ[name]
        clear_plugins()
        for file in self.plugins:
            use_plugin(file)


@dataclass(frozen=True)
class TaskBundle:
    """Work with its environment, sent to a worker once for all of its jobs."""

    name: str  # unique
    environment: WorkerEnvironment
    work: bytes  # pickled


@dataclass
class JobReply:
    """The reply of a worker: the value of the job, or the error that it raised."""

    value: Any = None
    error: Exception | None = None
    progress: float = 0.0  # the sum of what the work reported


@dataclass
class _LoadedWork:
    """The work that this process has unpickled last, kept for its next job."""

    name: str = ""
    work: Any = field(default=None, repr=False)


_loaded = _LoadedWork()


def run_job(fetch: Callable[[], TaskBundle], name: str, job: bytes, loads: Unpickle) -> JobReply:
    """Run a pickled job with the work of the bundle `name`, fetched unless it is loaded."""
    progress: list[float] = []
    try:
        if _loaded.name != name:
            _loaded.name, _loaded.work = "", None  # frees memory before the next work is loaded
            bundle = fetch()
            bundle.environment.apply()
            _loaded.name, _loaded.work = name, loads(bundle.work)
        with exits_as_errors():
            value = _loaded.work(loads(job), progress.append)
    except Exception as error:  # of any type: the submitter gets it
        keep_frames(error)
        error.add_note(f"in a worker on {platform.node()}:\n{traceback.format_exc()}")
        return JobReply(error=error)
    return JobReply(value, progress=sum(progress))


@lru_cache(maxsize=1)
def code_version() -> str:
    """Versions that decide results, and a hash of rlbench and of the installed plugins."""
    targets = {entry.target for group in GROUPS for entry in discovery.installed_entries(group)}
    packages = {"rlbench", *(target.partition(":")[0].partition(".")[0] for target in targets)}
    versions = " ".join(f"{name} {version}" for name, version in provenance.versions().items())
    return f"{versions}, code {code_hash.code_hash(packages, core=())}"


def _module_folders() -> list[str]:
    """The folders of `sys.path` that a Python process does not search by itself."""
    installed = tuple(
        sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")
    )
    folders = map(os.path.abspath, sys.path)
    return [path for path in folders if os.path.exists(path) and not path.startswith(installed)]
