"""Jobs in processes of this machine: each has one result, also if it ends its process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from rlbench.parallel.executor import LOCAL, ExecutorError, Resources
from rlbench.parallel.process_executor import ProcessExecutor
from rlbench.registry import list_plugins, use_plugin
from tests.conftest import write_plugin


def work(job, on_progress):
    if job == "crash":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "exit":
        sys.exit("bye")
    if job == "error":
        raise KeyError(job)
    return job, "toy" in list_plugins("methods"), torch.get_num_threads()


@pytest.mark.slow
def test_every_job_has_a_value_or_an_error_and_sees_the_plugins(tmp_path):
    use_plugin(write_plugin(tmp_path / "toy.py", "toy"))
    jobs = ["crash", "exit", "error", "value"]
    results = {r.job: r for r in ProcessExecutor(1).map(work, jobs, Resources(cpus=1))}
    assert list(results) == jobs  # one process keeps their order
    assert results["value"].value == ("value", True, 1)
    assert isinstance(results["error"].error, KeyError)
    assert isinstance(results["crash"].error, ExecutorError)
    assert "its process ended" in str(results["crash"].error)
    assert "plugin code called sys.exit('bye')" in str(results["exit"].error)


def test_no_jobs_start_no_process_and_times_are_measured_in_this_one():
    assert list(ProcessExecutor(2).map(work, [])) == []
    assert ProcessExecutor(2).local_exclusive() is LOCAL
    assert ProcessExecutor(2).description == "2 processes"


@pytest.mark.slow
def test_workers_end_when_their_parent_is_killed(tmp_path):
    """Each job writes its process number and waits; the parent is killed when both have."""
    parent = subprocess.Popen([sys.executable, "-c", PARENT, str(tmp_path)])
    wait_for(lambda: len(list(tmp_path.iterdir())) == 2)
    parent.kill()
    parent.wait()
    workers = [int(file.name) for file in tmp_path.iterdir()]
    wait_for(lambda: not any(is_running(worker) for worker in workers))


PARENT = """
import sys
from rlbench.parallel.process_executor import ProcessExecutor
from tests.parallel.test_process_executor import write_process_number
if __name__ == "__main__":
    list(ProcessExecutor(2).map(write_process_number, [sys.argv[1]] * 2))
"""


def write_process_number(folder, on_progress):
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(600)


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def wait_for(condition, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
