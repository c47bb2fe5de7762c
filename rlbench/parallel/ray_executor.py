"""Runs jobs on a Ray cluster, started on this machine or joined by its address.

If a worker dies (killed, out of memory, its machine lost), Ray runs its job again, at most
`max_retries` times. Jobs carry their data with them; files that they name must lie under the same
path on every machine, and rlbench must be installed there.
"""

from __future__ import annotations

import contextlib
import importlib
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rlbench.parallel import ray_cluster, worker
from rlbench.parallel.executor import (
    LOCAL,
    ONE_CPU,
    Executor,
    ExecutorError,
    J,
    JobResult,
    ProgressCallback,
    R,
    Resources,
    Work,
    ignore_progress,
)
from rlbench.parallel.ray_cluster import QUIET_ENVIRONMENT, import_ray

__all__ = ["EXECUTORS", "QUIET_ENVIRONMENT", "RayExecutor", "open_executor"]

EXECUTORS = ("local", "ray")
JOBS_PER_SLOT = 2  # submitted for each that can run, so that no worker waits for this process


@contextlib.contextmanager
def open_executor(name: str = "local", address: str | None = None) -> Iterator[Executor]:
    """Open the executor `local` or `ray`, and close it at the end of the block.

    `address` is that of a running Ray cluster, `auto` or host:port. Without one, Ray is started on
    this machine when the first job is submitted. Raises ExecutorError.
    """
    if name not in EXECUTORS:
        raise ExecutorError(
            f"--engine {name}: no such executor; use one of: {', '.join(EXECUTORS)}"
        )
    if name == "local":
        if address:
            raise ExecutorError(f"--ray-address {address} applies to --engine ray only")
        yield LOCAL
        return
    executor = RayExecutor(address)
    try:
        yield executor
    finally:
        executor.close()


@dataclass(frozen=True)
class RayExecutor:
    """Runs jobs on the workers of a Ray cluster. Starting or joining it takes some seconds."""

    address: str | None = None  # auto or host:port; None starts Ray on this machine
    max_retries: int = ray_cluster.MAX_RETRIES  # of a job whose worker died
    exclusive: bool = False

    def __post_init__(self) -> None:
        """Raise ExecutorError if Ray is not installed, or for the address of a Ray Client."""
        import_ray()
        if self.address and "://" in self.address:
            raise ExecutorError(
                f"--ray-address {self.address}: Ray Client is not supported. Run the command on a "
                "machine of the cluster, with auto or host:port"
            )

    @property
    def description(self) -> str:
        """Number of machines and processors of the cluster."""
        ray_cluster.start(self.address)
        machines = ray_cluster.machines()
        cpus = sum(int(resources["CPU"]) for resources in machines.values())
        location = "this machine" if len(machines) == 1 else f"{len(machines)} machines"
        return f"Ray on {location} with {cpus} processors"

    def local_exclusive(self) -> RayExecutor:
        """The same executor, with one job at a time that has this machine to itself."""
        return replace(self, exclusive=True)

    def close(self) -> None:
        """Stop the Ray started here, or leave the cluster joined."""
        ray_cluster.close()

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        resources: Resources = ONE_CPU,
        on_progress: ProgressCallback = ignore_progress,
    ) -> Iterator[JobResult[J, R]]:
        """Apply `work` to every job; yields one result for each, in the order of completion."""
        if not jobs:
            return
        ray = import_ray()
        ray_cluster.start(self.address)
        submit, limit = self._submitter(work, resources)
        queue = list(reversed(jobs))
        pending: dict[Any, J] = {}  # jobs by Ray's references to their replies
        try:
            while queue or pending:
                while queue and len(pending) < limit:
                    job = queue.pop()
                    pending[submit(job)] = job
                (reference,), _ = ray.wait(list(pending))
                job = pending.pop(reference)
                try:
                    reply = ray.get(reference)
                except ray.exceptions.RayError as error:
                    yield JobResult(job, error=self._lost(error))
                else:
                    on_progress(reply.progress)
                    yield JobResult(job, reply.value, reply.error)
        finally:
            for reference in pending:
                ray.cancel(reference, force=True)

    def _submitter(self, work: Work[J, R], resources: Resources) -> tuple[Callable[[J], Any], int]:
        """A function that submits a job, and the number of jobs that may be pending."""
        ray = import_ray()
        machines = ray_cluster.machines()
        if resources.gpus and not any(m.get("GPU", 0) >= resources.gpus for m in machines.values()):
            raise ExecutorError(
                f"a job takes {resources.gpus} GPU, and no machine of the Ray cluster has as many"
            )
        cpus, limit, strategy = self._placement(machines, resources)
        environment = worker.WorkerEnvironment.of_this_process(cpus)
        name, dumps = uuid.uuid4().hex, ray.cloudpickle.dumps
        # in a list, so that Ray does not fetch and unpickle the bundle for every job
        bundle = [ray.put(worker.TaskBundle(name, environment, dumps(work)))]
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

    def _lost(self, error: Exception) -> ExecutorError:
        """The error of a job without a reply: its workers died, or it could not be sent."""
        lines = str(error).strip().splitlines() or [""]
        if isinstance(error, ray_cluster.worker_deaths()):
            reason = f"{type(error).__name__}: {lines[0]}"
            times = self.max_retries + 1
            return ExecutorError(f"its worker died {times} times, the last time of {reason}")
        lost = ExecutorError(f"no worker could take the job or return its value: {lines[-1]}")
        lost.add_note(str(error))
        return lost


def _run_job(bundle: list[Any], name: str, job: bytes) -> worker.JobReply:
    """Run one job, in a worker."""
    ray = import_ray()
    pickle = ray.cloudpickle
    reply = worker.run_job(lambda: ray.get(bundle[0]), name, job, pickle.loads)
    try:
        pickle.loads(pickle.dumps(reply.error))
    except Exception:  # an error that cannot be pickled is sent as text
        notes = getattr(reply.error, "__notes__", ())
        reply.error = ExecutorError(f"{type(reply.error).__name__}: {reply.error}")
        reply.error.__notes__ = [*notes]
    return reply
