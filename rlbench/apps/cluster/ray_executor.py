"""Runs jobs on a Ray cluster, started on this machine or joined by its address.

If a worker dies (killed, out of memory, its machine lost), Ray runs its job again, at most
`max_retries` times. Jobs carry their data with them; files that they name must lie under the same
path on every machine, and rlbench must be installed there. A worker runs jobs in the environment of
the process that submitted them.
"""

from __future__ import annotations

import importlib
import os
import platform
import sys
import sysconfig
import traceback
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from rlbench.apps.cluster.ray_cluster import (
    MAX_RETRIES,
    ClusterLostError,
    ClusterWatch,
    import_ray,
    list_machines,
    start_ray,
    stop_ray,
)
from rlbench.parallel.executor import (
    ONE_CPU,
    ExecutorError,
    J,
    JobResult,
    ProgressCallback,
    R,
    Resources,
    Work,
    ignore_progress,
)
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

LOOK_SECONDS = 2.0  # at most, between two looks at the machines of the cluster
JOBS_PER_SLOT = 2  # submitted for each that can run, so that no worker waits for this process
PREFIX = "RLBENCH_"  # of the environment variables that a worker takes over
THREADS = f"{PREFIX}THREADS"  # of the path tracer


@dataclass(frozen=True)
class RayExecutor:
    """Runs jobs on the workers of a Ray cluster. Starting or joining it takes some seconds."""

    address: str | None = None  # auto or host:port; None starts Ray on this machine
    max_retries: int = MAX_RETRIES  # of a job whose worker died
    exclusive: bool = False

    def __post_init__(self) -> None:
        """Raise ExecutorError if Ray is not installed, or for the address of a Ray Client."""
        import_ray()
        if self.address and "://" in self.address:
            raise ExecutorError(
                f"--engine ray={self.address}: Ray Client is not supported. Run the command on a "
                "machine of the cluster, with auto or host:port"
            )

    @property
    def description(self) -> str:
        """Number of machines and processors of the cluster."""
        start_ray(self.address)
        machines = list_machines()
        cpus = sum(int(resources["CPU"]) for resources in machines.values())
        location = "this machine" if len(machines) == 1 else f"{len(machines)} machines"
        return f"Ray on {location} with {cpus} processors"

    def local_exclusive(self) -> RayExecutor:
        """The same executor, with one job at a time that has this machine to itself."""
        return replace(self, exclusive=True)

    def close(self) -> None:
        """Stop the Ray started here, or leave the cluster joined."""
        stop_ray()

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        resources: Resources = ONE_CPU,
        on_progress: ProgressCallback = ignore_progress,
    ) -> Iterator[JobResult[J, R]]:
        """Apply `work` to every job; yields one result for each, in the order of completion.

        Raises ClusterLostError where the cluster itself is gone.
        """
        if not jobs:
            return
        ray = import_ray()
        start_ray(self.address)
        submit, limit = self._submitter(work, resources)
        queue = list(reversed(jobs))
        pending: dict[Any, J] = {}  # jobs by Ray's references to their replies
        watch = ClusterWatch()
        try:
            while queue or pending:
                while queue and len(pending) < limit:
                    job = queue.pop()
                    pending[submit(job)] = job
                finished, _ = ray.wait(list(pending), timeout=LOOK_SECONDS)
                watch.look()
                for reference in finished:
                    yield self._result(pending[reference], reference, on_progress)
                    del pending[reference]
        except (ClusterLostError, ray.exceptions.LocalRayletDiedError) as error:
            left = len(queue) + len(pending)
            raise ClusterLostError(
                f"the Ray cluster {f'at {self.address}' if self.address else 'here'} is lost: "
                f"{len(jobs) - left} of {len(jobs)} jobs are finished and kept, {left} are not. "
                f"{'Start Ray there again, and repeat' if self.address else 'Repeat'} the command: "
                "it continues"
            ) from error
        finally:
            for reference in pending:
                ray.cancel(reference, force=True)

    def _submitter(self, work: Work[J, R], resources: Resources) -> tuple[Callable[[J], Any], int]:
        """A function that submits a job, and the number of jobs that may be pending."""
        ray = import_ray()
        machines = list_machines()
        if resources.gpus and not any(m.get("GPU", 0) >= resources.gpus for m in machines.values()):
            raise ExecutorError(
                f"a job takes {resources.gpus} GPU, and no machine of the Ray cluster has as many"
            )
        cpus, limit, strategy = self._placement(machines, resources)
        environment = WorkerEnvironment.of_this_process(cpus)
        name, dumps = uuid.uuid4().hex, ray.cloudpickle.dumps
        # in a list, so that Ray does not fetch and unpickle the bundle for every job
        bundle = [ray.put(TaskBundle(name, environment, dumps(work)))]
        remote = ray.remote(_run_job).options(
            num_cpus=cpus,
            num_gpus=resources.gpus,
            max_retries=self.max_retries,
            scheduling_strategy=strategy,
            runtime_env=environment.runtime_env(),
        )
        return lambda job: remote.remote(bundle, name, dumps(job)), limit

    def _placement(
        self, machines: dict[str, dict[str, float]], resources: Resources
    ) -> tuple[int, int, Any]:
        """CPUs of each job, the number of pending jobs, and Ray's scheduling strategy."""
        if self.exclusive:
            here = import_ray().get_runtime_context().get_node_id()
            cpus = int(machines.get(here, {"CPU": 0})["CPU"])
            strategies = importlib.import_module("ray.util.scheduling_strategies")
            return cpus, 1, strategies.NodeAffinitySchedulingStrategy(here, soft=False)
        available = [int(machine["CPU"]) for machine in machines.values()]
        cpus = min(resources.cpus, *available)
        return cpus, JOBS_PER_SLOT * sum(count // cpus for count in available), "SPREAD"

    def _result(self, job: J, reference: Any, on_progress: ProgressCallback) -> JobResult[J, R]:
        """The result of a job that has ended. Raises LocalRayletDiedError of Ray."""
        ray = import_ray()
        try:
            reply = ray.get(reference)
        except ray.exceptions.LocalRayletDiedError:
            raise
        except ray.exceptions.RayError as error:
            return JobResult(job, error=self._lost(error))
        on_progress(reply.progress)
        return JobResult(job, reply.value, reply.error)

    def _lost(self, error: Exception) -> ExecutorError:
        """The error of a job without a reply: its workers died, or it could not be sent."""
        lines = str(error).strip().splitlines() or [""]
        if isinstance(error, _worker_deaths()):
            reason = f"{type(error).__name__}: {lines[0]}"
            times = self.max_retries + 1
            return ExecutorError(f"its worker died {times} times, the last time of {reason}")
        lost = ExecutorError(f"no worker could take the job or return its value: {lines[-1]}")
        lost.add_note(str(error))
        return lost


def _run_job(bundle: list[Any], name: str, job: bytes) -> JobReply:
    """Run one job, in a worker."""
    ray = import_ray()
    pickle = ray.cloudpickle
    reply = run_job(lambda: ray.get(bundle[0]), name, job, pickle.loads)
    try:
        pickle.loads(pickle.dumps(reply.error))
    except Exception:  # an error that cannot be pickled is sent as text
        notes = getattr(reply.error, "__notes__", ())
        reply.error = ExecutorError(f"{type(reply.error).__name__}: {reply.error}")
        reply.error.__notes__ = [*notes]
    return reply


def _worker_deaths() -> tuple[type[Exception], ...]:
    """Ray's errors for a worker that died, so that another one may succeed."""
    errors = import_ray().exceptions
    return (
        errors.WorkerCrashedError,
        errors.OutOfMemoryError,
        errors.NodeDiedError,
        errors.ObjectLostError,
    )


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
