"""Settings of processes for long work: memory that is kept, threads that sleep, a common end."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # <malloc.h> of the GNU C library
GIGABYTE = 2**30
PR_SET_PDEATHSIG = 1  # linux/prctl.h


def keep_freed_memory() -> bool:
    """Let the C library reuse freed memory, not return it to the system; False if it cannot.

    By default glibc maps a tensor above 32 MiB anew whenever one is created, and the system clears
    its pages: at 720 x 720, two fifths of the time of `ours`. It returns smaller ones too, which
    takes a fifth of a frame at 192 x 192 and a tenth of a training step. A renderer allocates its
    buffers once. The process keeps its largest size until it ends. Other C libraries are left as
    they are.
    """
    if sys.platform != "linux":
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:  # musl
        return False
    return bool(mallopt(M_MMAP_THRESHOLD, GIGABYTE) and mallopt(M_TRIM_THRESHOLD, 2 * GIGABYTE - 1))


def wait_asleep() -> None:
    """Let threads that wait sleep, where they would spin. Call this before torch is imported.

    Torch's OpenMP threads spin between parallel loops. On an idle machine that saves some
    microseconds a loop; beside other processes a waiting thread takes the processor from the one
    that it waits for, and a run takes several times as long. A policy that the user has set in
    the environment variable OMP_WAIT_POLICY stays.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")


def end_with_parent() -> Callable[[], None]:
    """For `preexec_fn` of a process started here: it ends with this one, also after kill -9.

    Elsewhere than on Linux it goes on.
    """
    parent, libc = os.getpid(), ctypes.CDLL(None)

    def follow() -> None:
        if sys.platform == "linux":
            libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before
            os._exit(1)

    return follow


@contextmanager
def postpone_end() -> Iterator[Callable[[], bool]]:
    """Let SIGTERM wait until this context ends; the function is True once it came.

    The process then ends, by SystemExit with code 143. In another thread than the main one the
    function is never True, and the signal does what it did.
    """
    came = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield came.is_set
        return
    before = signal.signal(signal.SIGTERM, lambda number, frame: came.set())
    try:
        yield came.is_set
    finally:
        signal.signal(signal.SIGTERM, before)
    if came.is_set():
        raise SystemExit(128 + signal.SIGTERM)
