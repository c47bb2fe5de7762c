"""The Ray cluster that runs jobs: started or joined, its machines, and what is lost of it."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import socket
import sys
from collections.abc import Mapping
from typing import Any

from rlbench.parallel.engines import QUIET_RAY
from rlbench.parallel.executor import ExecutorError, TimeLimit
from rlbench.system import provenance

MAX_RETRIES = 3  # of a job whose worker died
ENVIRONMENT = {
    **QUIET_RAY,
    "RAY_worker_niceness": "0",  # times are measured at normal priority
    "RAY_task_oom_retries": str(MAX_RETRIES),  # by default Ray retries without end
}
PATIENCE = 0.5  # minutes without an answer of the cluster; Ray ends this process after one
ANSWER_SECONDS = 2.0  # that a live cluster needs at most to accept a connection
_logger = logging.getLogger(__name__)


def start_ray(address: str | None) -> None:
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


def stop_ray() -> None:
    """Stop the Ray started here, or leave the cluster joined."""
    ray = import_ray()
    if ray.is_initialized():
        with contextlib.redirect_stdout(sys.stderr):  # stdout is for results
            ray.shutdown()


def import_ray() -> Any:
    """The module `ray`; its environment variables must be set before it is imported."""
    os.environ.update(ENVIRONMENT)
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise ExecutorError(
            f'--engine ray needs Ray, which is not installed ({error}): pip install "rlbench[ray]"'
        ) from error


def list_machines() -> dict[str, dict[str, float]]:
    """Resources of the machines that have processors, by Ray's ids. Raises ExecutorError."""
    nodes = [node for node in import_ray().nodes() if node["Alive"]]
    resources = {node["NodeID"]: node["Resources"] for node in nodes}
    usable = {name: machine for name, machine in resources.items() if machine.get("CPU", 0) >= 1}
    if not usable:
        raise ExecutorError(f"none of the {len(nodes)} machines of the Ray cluster has processors")
    return usable


class ClusterLostError(ExecutorError):
    """A cluster that is gone, so that no job can run."""


class ClusterWatch:
    """Says which machines a cluster loses, and whether it is lost itself."""

    def __init__(self) -> None:
        """Note the machines of today."""
        self._machines = list_machines()
        self._address = import_ray().get_runtime_context().gcs_address
        self._patience: TimeLimit | None = None  # since the cluster does not answer

    def look(self) -> None:
        """Log one line for each machine that is lost since the last look.

        Raises ClusterLostError where the cluster has not answered for long.
        """
        if not self._is_answering():
            self._patience = self._patience or TimeLimit(PATIENCE)
            if not self._patience.minutes_left:
                raise ClusterLostError(f"{self._address} does not answer")
            return
        self._patience = None
        nodes = {node["NodeID"]: node for node in import_ray().nodes()}
        alive = {name: node["Resources"] for name, node in nodes.items() if node["Alive"]}
        for name in self._machines.keys() - alive.keys():
            _logger.warning("%s", _loss(nodes[name], self._machines[name], alive))
        self._machines = alive

    def _is_answering(self) -> bool:
        """Whether the head accepts connections; Ray's own calls would wait for it in vain."""
        host, _, port = self._address.rpartition(":")
        try:
            socket.create_connection((host, int(port)), ANSWER_SECONDS).close()
        except OSError:
            return False
        return True


def _loss(
    node: Mapping[str, Any], machine: Mapping[str, float], others: Mapping[str, Mapping[str, float]]
) -> str:
    """What is lost with a machine, and what happens now."""
    left = sum(each.get("CPU", 0) >= 1 for each in others.values())
    place = f"again on the {left} that are left" if left else "when another machine joins"
    return (
        f"Ray lost the machine {node['NodeManagerHostname']} with {machine.get('CPU', 0):.0f} "
        f"processors; finished jobs are kept, and those that ran there run {place}"
    )
