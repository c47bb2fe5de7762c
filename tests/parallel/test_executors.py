"""Jobs in processes, each with one result, also if it ends its process; and under a limit."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from rlbench.parallel.executor import (
    LOCAL,
    ExecutorError,
    OutOfTimeError,
    Resources,
    TimeLimit,
    TimeLimitedExecutor,
)
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
from tests.parallel.test_executors import write_process_number
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


def double(job, on_progress):
    return 2 * job


@pytest.mark.parametrize(("limit", "jobs"), [(TimeLimit(), [1, 2, 3]), (TimeLimit(1e-9), [1])])
def test_without_a_limit_or_before_its_end_every_job_is_done(limit, jobs):
    results = TimeLimitedExecutor(limit).map(double, jobs)
    assert [result.value for result in results] == [2 * job for job in jobs]
    assert TimeLimit().minutes_left == math.inf


def test_after_the_limit_no_job_begins_and_done_ones_are_kept():
    results = TimeLimitedExecutor(TimeLimit(1e-9)).map(double, [1, 2, 3])
    assert next(results).value == 2
    with pytest.raises(OutOfTimeError, match="1e-09 minutes are over, and 2 of 3 jobs are not"):
        next(results)


def test_the_rest_is_that_of_the_executor():
    limited = TimeLimitedExecutor(TimeLimit(3), LOCAL)
    assert (limited.exclusive, limited.description) == (LOCAL.exclusive, LOCAL.description)
    assert limited.local_exclusive() == limited
    assert 2.9 < limited.limit.minutes_left < 3
