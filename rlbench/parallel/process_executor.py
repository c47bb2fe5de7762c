"""Runs jobs in a few processes of this machine; a job that ends its process is lost alone."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from rlbench.parallel.executor import (
    LOCAL,
    ONE_CPU,
    ExecutorError,
    J,
    JobResult,
    LocalExecutor,
    ProgressCallback,
    R,
    Resources,
    Work,
    ignore_progress,
)
from rlbench.registry import exits_as_errors, plugin_files, use_plugin
from rlbench.registry.failure import keep_frames

_work: list[Any] = []  # of this worker process


@dataclass(frozen=True)
class ProcessExecutor:
    """Runs jobs in `processes` processes, each with its own copy of the work.

    Ray does this on many machines; these processes need no further package and start at once.
    """

    processes: int = 2
    exclusive: bool = False

    @property
    def description(self) -> str:
        """Number of processes."""
        return f"{self.processes} processes"

    def local_exclusive(self) -> LocalExecutor:
        """This process, which runs one job after another."""
        return LOCAL

    def map(
        self,
        work: Work[J, R],
        jobs: Sequence[J],
        resources: Resources = ONE_CPU,
        on_progress: ProgressCallback = ignore_progress,
    ) -> Iterator[JobResult[J, R]]:
        """Apply `work` to every job; yields one result for each, in the order of completion.

        A job that ends its process (a crash, out of memory) has an ExecutorError. `resources`
        sets the number of torch's threads per process; progress is not reported.
        """
        queue, others = deque(jobs), set(multiprocessing.active_children())
        arguments = (work, plugin_files.plugin_files(), resources.cpus)
        count = min(self.processes, len(queue))
        idle = [_start(arguments) for _ in range(count)]
        running: dict[Future[R], tuple[J, ProcessPoolExecutor]] = {}
        try:
            while queue or running:
                while queue and idle:
                    job, worker = queue.popleft(), idle.pop()
                    with _ignoring_interrupts():
                        running[worker.submit(_run, job)] = job, worker
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job, worker = running.pop(future)
                    is_lost = isinstance(future.exception(), BrokenProcessPool)
                    idle.append(_start(arguments) if is_lost else worker)
                    yield _job_result(job, future)
        finally:
            for worker in [*idle, *(worker for _, worker in running.values())]:
                worker.shutdown(wait=False, cancel_futures=True)
            if running:  # interrupted: nobody waits for these jobs
                for process in set(multiprocessing.active_children()) - others:
                    process.terminate()


def _start(arguments: tuple[Any, tuple[Path, ...], int]) -> ProcessPoolExecutor:
    """A pool of one process, so that a crash breaks no other job."""
    context = multiprocessing.get_context("spawn")  # a fork would copy torch's threads
    return ProcessPoolExecutor(1, context, initializer=_set_up, initargs=arguments)


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Processes that start in this block ignore Ctrl-C, which a terminal sends to all of them.

    The process that started them ends them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler or signal.default_int_handler)


def _set_up(work: Any, plugins: tuple[Path, ...], threads: int) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    torch.set_num_threads(threads)
    for file in plugins:
        use_plugin(file)
    _work[:] = [work]


def _end_with_parent() -> None:
    """End this process when its parent is killed; it would wait for jobs for ever."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


def _run(job: Any) -> Any:
    try:
        with exits_as_errors():
            return _work[0](job, ignore_progress)
    except Exception as error:  # of any type: the submitter gets it
        keep_frames(error)
        raise


def _job_result(job: J, future: Future[R]) -> JobResult[J, R]:
    error = future.exception()
    if error is None:
        return JobResult(job, future.result())
    if isinstance(error, BrokenProcessPool):
        lost = ExecutorError("its process ended: it crashed, or ran out of memory")
        return JobResult(job, error=lost)
    if isinstance(error, Exception):
        return JobResult(job, error=error)
    return JobResult(job, error=ExecutorError(f"it raised {type(error).__name__}: {error}"))
