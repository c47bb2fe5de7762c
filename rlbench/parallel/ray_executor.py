"""Jobs on a Ray cluster: started here or joined by its address, quiet, with lost jobs sent again.

A worker that dies (killed, out of memory, its machine gone) takes one job with it, which is sent
again up to `retries` times. Jobs carry their data with them; files that they name must lie under
the same path on every machine, and rlbench must be installed there.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import sys
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rlbench.parallel import worker
from rlbench.parallel.executor import (
    LOCAL,
    ONE,
    EngineError,
    Executor,
    J,
    JobResult,
    ProgressCallback,
    R,
    Resources,
    Work,
)
from rlbench.system import provenance

ENGINES = ("local", "ray")
RETRIES = 3
QUEUED = 2  # jobs sent for each that can run, so that no worker waits for this process
QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",  # Ray reports what it is used for unless told not to
    "RAY_USAGE_STATS_PROMPT_ENABLED": "0",
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",  # else `uv run` packs and sends the working folder
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # or it warns that this will be so
    "RAY_enable_metrics_collection": "0",
    "RAY_worker_niceness": "0",  # times are of a worker that nobody else on the machine starves
}


@contextlib.contextmanager
def opened(name: str = "local", address: str | None = None) -> Iterator[Executor]:
    """The engine of that name, for as long as the block lasts.

    `address` is that of a running Ray cluster, `auto` or host:port; without one, Ray is started on
    this machine when the first job is. Raises EngineError.
    """
    if name not in ENGINES:
        raise EngineError(f"--engine {name}: jobs are run by one of: {', '.join(ENGINES)}")
    if name == "local":
        if address:
            raise EngineError(f"--ray-address {address} belongs to --engine ray")
        yield LOCAL
        return
    cluster = RayExecutor(address)
    try:
        yield cluster
    finally:
        cluster.close()


@dataclass(frozen=True)
class RayExecutor:
    """Runs jobs on the workers of a Ray cluster. Starting and joining it takes some seconds."""

    address: str | None = None  # auto or host:port; None for one on this machine alone
    retries: int = RETRIES  # of a job whose worker died
    exclusive: bool = False

    def __post_init__(self) -> None:
        """Raise EngineError where Ray is missing, or cannot be used by this address."""
        _ray()
        if self.address and "://" in self.address:
            raise EngineError(
                f"--ray-address {self.address}: Ray Client is not used here; give the command on a "
                "machine of the cluster, with auto or host:port"
            )

    @property
    def where(self) -> str:
        """Machines and processors of the cluster."""
        self._start()
        found = _machines()
        cpus = sum(int(each["CPU"]) for each in found.values())
        machines = "this machine" if len(found) == 1 else f"{len(found)} machines"
        return f"Ray on {machines} with {cpus} processors"

    def local_exclusive(self) -> RayExecutor:
        """The same on this machine, one job after another, each with the machine to itself."""
        return replace(self, exclusive=True)

    def close(self) -> None:
        """Stop what was started, or leave what was joined."""
        ray = _ray()
        if ray.is_initialized():
            with contextlib.redirect_stdout(sys.stderr):  # Ray's last words are no results
                ray.shutdown()

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        share: Resources = ONE,
        tell: ProgressCallback = lambda done: None,
    ) -> Iterator[JobResult[J, R]]:
        """One outcome for each job, in the order in which they end."""
        if not jobs:
            return
        ray = _ray()
        self._start()
        send, most = self._sender(work, share)
        waiting: dict[Any, tuple[J, int]] = {}  # by reference: a job, and how often it was sent
        todo = list(reversed(jobs))
        try:
            while todo or waiting:
                while todo and len(waiting) < most:
                    job = todo.pop()
                    waiting[send(job)] = (job, 1)
                (ready,), _ = ray.wait(list(waiting))
                job, sent = waiting.pop(ready)
                try:
                    answer = ray.get(ready)
                except ray.exceptions.RayError as error:
                    if sent <= self.retries and _died(error):
                        waiting[send(job)] = (job, sent + 1)
                    else:
                        yield JobResult(job, error=_lost(error, sent))
                else:
                    tell(answer.told)
                    yield JobResult(job, answer.made, answer.error)
        finally:
            for each in waiting:
                ray.cancel(each, force=True)

    def _start(self) -> None:
        ray = _ray()
        if ray.is_initialized():
            return
        here = {} if self.address else {"num_cpus": provenance.machine().cores}
        try:
            ray.init(
                address=self.address or "local",
                include_dashboard=None if self.address else False,
                log_to_driver=False,
                logging_level=logging.ERROR,
                **here,
            )
        except Exception as error:  # of whatever kind: a busy machine is told by a bare one
            asked = f"no Ray cluster at {self.address}" if self.address else "Ray did not start"
            words = (str(error).splitlines() or [""])[0]
            raise EngineError(f"{asked}: {type(error).__name__}: {words}") from error

    def _sender(self, work: Work[J, R], share: Resources) -> tuple[Any, int]:
        """What sends a job to a worker, and how many jobs may be on their way."""
        ray = _ray()
        machines = _machines()
        strategies = importlib.import_module("ray.util.scheduling_strategies")
        if self.exclusive:
            here = ray.get_runtime_context().get_node_id()
            cpus = int(machines.get(here, {"CPU": 0})["CPU"])
            where: Any = strategies.NodeAffinitySchedulingStrategy(here, soft=False)
            most = 1
        else:
            cpus = min(share.cpus, *(int(each["CPU"]) for each in machines.values()))
            where = "SPREAD"
            most = QUEUED * sum(int(each["CPU"]) // cpus for each in machines.values())
        if share.gpus and not any(each.get("GPU", 0) >= share.gpus for each in machines.values()):
            raise EngineError(f"a job takes {share.gpus} GPU, and no machine of the cluster has it")
        remote = ray.remote(_run).options(
            num_cpus=cpus, num_gpus=share.gpus, max_retries=0, scheduling_strategy=where
        )
        name, dumps = uuid.uuid4().hex, ray.cloudpickle.dumps
        parcel = [ray.put(worker.TaskBundle(name, worker.setting(cpus), dumps(work)))]
        return lambda job: remote.remote(parcel, name, dumps(job)), most


def _run(parcel: list[Any], name: str, job: bytes) -> worker.JobReply:
    """One job, in a worker; the parcel is in a list so that Ray does not unpack it every time."""
    ray = _ray()
    pickled = ray.cloudpickle
    answer = worker.run(lambda: ray.get(parcel[0]), name, job, pickled.loads)
    try:
        pickled.loads(pickled.dumps(answer.error))
    except Exception:  # an error that cannot travel is told in words
        notes = getattr(answer.error, "__notes__", ())
        answer.error = EngineError(f"{type(answer.error).__name__}: {answer.error}")
        answer.error.__notes__ = [*notes]
    return answer


def _ray() -> Any:
    """Ray itself, told to be quiet before it is imported."""
    os.environ.update(QUIET)
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise EngineError(
            f'--engine ray needs Ray, which is not there ({error}): pip install "rlbench[ray]"'
        ) from error


def _machines() -> dict[str, dict[str, float]]:
    """Resources of the machines that have processors, by Ray's name. Raises EngineError."""
    nodes = [node for node in _ray().nodes() if node["Alive"]]
    found = {node["NodeID"]: node["Resources"] for node in nodes}
    usable = {name: each for name, each in found.items() if each.get("CPU", 0) >= 1}
    if not usable:
        raise EngineError(f"none of the {len(found)} machines of the Ray cluster has processors")
    return usable


def _died(error: Exception) -> bool:
    """Was it the worker that came to an end, so that another one may do better?"""
    kinds = _ray().exceptions
    return isinstance(
        error,
        kinds.WorkerCrashedError
        | kinds.OutOfMemoryError
        | kinds.NodeDiedError
        | kinds.ObjectLostError
        | kinds.LocalRayletDiedError,
    )


def _lost(error: Exception, sent: int) -> EngineError:
    """Why there is no answer to a job."""
    lines = str(error).strip().splitlines() or [""]
    if _died(error):
        first = f"{type(error).__name__}: {lines[0]}"
        return EngineError(f"its worker died {sent} times, the last time of {first}")
    lost = EngineError(f"no worker could take the job or hand back what it made: {lines[-1]}")
    lost.add_note(str(error))
    return lost
