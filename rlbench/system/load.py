"""How busy this machine is, and what a time on a busy machine says of the quiet one.

Other programs only add time. A process that gets the share `s` of the processor time that it asks
for is slower by 1 / s at least. Where threads wait for each other, a step of the work needs two of
them at once, which happens for a share s x s of the time if their turns are independent. The quiet
time is therefore at least the fastest time x s x s, at most the median, and near the fastest time
x s. docs/concepts/time.md shows how often such an interval holds the quiet time.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, TypeVar

SCHEDULER = Path("/proc/self/task")  # a folder for each thread, with its schedstat
MIN_PROCESSOR_SHARE = 0.8  # of the processor time that its threads ask for, on a quiet machine
T = TypeVar("T")


class TimeEstimate(NamedTuple):
    """The time that a quiet machine would take, and an interval for it, milliseconds."""

    ms: float
    low: float
    high: float


def processor_ms() -> float:
    """Processor time of this process, all threads together."""
    return time.process_time() * 1e3


def waiting_ms() -> float:
    """Time of all threads of this process in the queue for a processor; nan but on Linux."""
    if not SCHEDULER.is_dir():
        return math.nan
    waited_ns = 0
    for file in SCHEDULER.glob("*/schedstat"):
        with suppress(OSError):  # of a thread that has just ended
            waited_ns += int(file.read_text().split()[1])
    return waited_ns / 1e6


def running_share(ran_ms: float, waited_ms: float) -> float:
    """The share of the processor time that threads asked for and got; nan where it is not known."""
    return ran_ms / (ran_ms + waited_ms) if ran_ms + waited_ms > 0 else math.nan


def fastest_tenth(ordered: Sequence[T]) -> Sequence[T]:
    """The first tenth of an ordered sequence; at least one.

    >>> fastest_tenth(range(30))
    range(0, 3)
    """
    return ordered[: max(len(ordered) // 10, 1)]


def estimate_quiet_ms(times: Sequence[float], share: float) -> TimeEstimate:
    """The quiet time behind `times`, milliseconds, of a process that got `share` of its processors.

    >>> estimate_quiet_ms([20.0, 24.0, 30.0], 0.5)
    TimeEstimate(ms=10.0, low=5.0, high=24.0)
    """
    fastest = statistics.fmean(fastest_tenth(sorted(times)))
    return TimeEstimate(fastest * share, fastest * share**2, statistics.median(times))
