"""A run on a Ray cluster that loses a machine, or a process of its head, after the first job.

Command: python -m tests.apps.cluster.losing_run PART FOLDER, where PART is machine, gcs_server or
raylet. It prints the values of its jobs. It is a process of its own because Ray may end it.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import typer

from rlbench.apps.cluster import ray_cluster
from rlbench.apps.cluster.ray_cluster import ClusterLostError
from rlbench.apps.cluster.ray_executor import RayExecutor
from rlbench.cli.verbosity import set_verbosity

JOBS = range(6)
QUICK = {"health_check_period_ms": 500, "health_check_failure_threshold": 2}


def wait_and_tell(folder: Path, endless: str, job: int, on_progress: Any) -> int:
    """Leave a file, and take a while; on the machine `endless` for ever."""
    machine = ray_cluster.import_ray().get_runtime_context().get_node_id()
    (folder / f"{job}-{machine}").touch()
    time.sleep(600 if machine == endless else 1)
    return 10 * job


def lose(cluster: Any, other: Any, part: str, folder: Path) -> None:
    """Kill the other machine while it runs a job, or a process of the head."""
    if part == "machine":
        while not list(folder.glob(f"*-{other.node_id}")):
            time.sleep(0.1)
        cluster.remove_node(other, allow_graceful=False)
        return
    for each in cluster.head_node.all_processes[part]:
        os.kill(each.process.pid, signal.SIGKILL)


def main(part: str, folder: Path) -> None:
    """Run the jobs, and print their values, or the error."""
    set_verbosity(verbose=False, quiet=False)
    ray_cluster.PATIENCE = 0.05
    ray_cluster.import_ray()
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "_system_config": QUICK})
    other = cluster.add_node(num_cpus=1) if part == "machine" else None
    work = partial(wait_and_tell, folder, other.node_id if other else "")
    executor, values = RayExecutor(cluster.address), list[int]()
    try:
        for result in executor.map(work, JOBS):
            values.append(result.result())
            if len(values) == 1:
                lose(cluster, other, part, folder)
        typer.echo(sorted(values))
    except ClusterLostError as error:
        typer.echo(error)
    finally:
        executor.close()
        cluster.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
