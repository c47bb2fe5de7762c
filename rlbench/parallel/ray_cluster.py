"""A Ray cluster: started on this machine or joined, without messages and usage reports."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import sys
from typing import Any

from rlbench.parallel.executor import ExecutorError
from rlbench.system import provenance

__all__ = [
    "MAX_RETRIES",
    "QUIET_ENVIRONMENT",
    "close",
    "import_ray",
    "machines",
    "start",
    "worker_deaths",
]

MAX_RETRIES = 3  # of a job whose worker died
QUIET_ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",  # by default Ray reports usage statistics
    "RAY_USAGE_STATS_PROMPT_ENABLED": "0",
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",  # else `uv run` packs and sends the working directory
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # else Ray warns that this will be the default
    "RAY_enable_metrics_collection": "0",
    "RAY_worker_niceness": "0",  # times are measured at normal priority
    "RAY_task_oom_retries": str(MAX_RETRIES),  # by default Ray retries without end
}


def start(address: str | None) -> None:
    """Join the cluster at `address`, or start Ray on this machine; does nothing the second time.

    Raises ExecutorError.
    """
    ray = import_ray()
    if ray.is_initialized():
        return
    local_only = {} if address else {"num_cpus": provenance.machine().cores}
    try:
        ray.init(
            address=address or "local",
            include_dashboard=None if address else False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            **local_only,
        )
    except Exception as error:  # Ray raises plain exceptions too, for example on a busy machine
        failure = f"no Ray cluster at {address}" if address else "Ray did not start"
        reason = (str(error).splitlines() or [""])[0]
        raise ExecutorError(f"{failure}: {type(error).__name__}: {reason}") from error


def close() -> None:
    """Stop the Ray started here, or leave the cluster joined."""
    ray = import_ray()
    if ray.is_initialized():
        with contextlib.redirect_stdout(sys.stderr):  # stdout is for results
            ray.shutdown()


def import_ray() -> Any:
    """The module `ray`; its environment variables must be set before it is imported."""
    os.environ.update(QUIET_ENVIRONMENT)
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise ExecutorError(
            f'--engine ray needs Ray, which is not installed ({error}): pip install "rlbench[ray]"'
        ) from error


def machines() -> dict[str, dict[str, float]]:
    """Resources of the machines that have processors, by Ray's ids. Raises ExecutorError."""
    nodes = [node for node in import_ray().nodes() if node["Alive"]]
    resources = {node["NodeID"]: node["Resources"] for node in nodes}
    usable = {name: machine for name, machine in resources.items() if machine.get("CPU", 0) >= 1}
    if not usable:
        raise ExecutorError(f"none of the {len(nodes)} machines of the Ray cluster has processors")
    return usable


def worker_deaths() -> tuple[type[Exception], ...]:
    """Ray's errors for a worker that died, so that another one may succeed."""
    errors = import_ray().exceptions
    return (
        errors.WorkerCrashedError,
        errors.OutOfMemoryError,
        errors.NodeDiedError,
        errors.ObjectLostError,
        errors.LocalRayletDiedError,
    )
