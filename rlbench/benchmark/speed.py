"""Speed of methods by image size, backend and precision, on generated frames.

No score is measured. Times are those of `rlbench run`: interleaved rounds, with notes where the
machine was busy. Work and memory are counted by PyTorch while it runs one frame.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import pandas as pd
import torch

from rlbench import registry
from rlbench.backends import EAGER, use_backend
from rlbench.benchmark.clock.stopwatch import SystemClock
from rlbench.benchmark.latency import REPEATS, TimedRow, Timing, time_methods
from rlbench.benchmark.results import UNRELIABLE
from rlbench.benchmark.work import (
    SPP,
    count_multiply_adds,
    count_parameters,
    generated_clip,
    peak_memory,
    state_bytes,
)
from rlbench.checks.returns import CheckedReturns
from rlbench.clips.in_memory import InMemoryClip
from rlbench.method import Method
from rlbench.parallel.executor import LOCAL, JobResult, ProgressCallback
from rlbench.wrappers import HalfPrecision

__all__ = [
    "COLUMNS",
    "Configuration",
    "failed_rows",
    "measure_speed",
]

PEAK_SIDE, PEAK_RUNS = 2048, 5  # of the matrix product that stands for the machine's peak
COLUMNS = {
    "method": "row name, with backend and precision",
    "height": "pixels",
    "width": "pixels",
    "plan_ms": "mean of the middle half of the frames",
    "allocate_ms": "likewise",
    "denoise_ms": "likewise",
    "inference_ms": "sum of the three",
    "inference_p95_ms": "95th percentile",
    "parameters": "thousands, of the networks that PyTorch runs",
    "multiply_adds": "thousands per pixel, of convolutions and matrix products",
    "peak_share": "of the throughput of a matrix product in the same precision",
    "state_bytes": "per pixel, of all tensors that are kept for the next frame",
    "memory_mb": "most memory of tensors during a frame, beyond its input",
    "note": "why a time must not be believed",
}

PixelSize = tuple[int, int]  # height, width


@dataclass(frozen=True)
class Configuration:
    """A method, what runs its networks, and in which precision."""

    method: str
    backend: str = EAGER
    bf16: bool = False

    @property
    def row_name(self) -> str:
        """The name as in the results."""
        label = "-".join(
            ([self.backend] if self.backend != EAGER else []) + (["bf16"] if self.bf16 else [])
        )
        return f"{self.method}@{label}" if label else self.method

    def load(self, device: torch.device) -> Method:
        """The method with its shipped weights, or random ones: they change no time."""
        is_trained = registry.get_variant(self.method).pretrained
        weights = None if is_trained else "random"
        method = CheckedReturns(registry.load_method(self.method, device, weights))
        use_backend(method, self.backend, device, self.bf16)
        return HalfPrecision(method, device) if self.bf16 else method


def measure_speed(
    configurations: Sequence[Configuration],
    sizes: Sequence[PixelSize],
    device: torch.device,
    repeats: int = REPEATS,
    on_done: Callable[[], None] = lambda: None,
) -> pd.DataFrame:
    """One line per configuration and size, with the columns of `COLUMNS`.

    Configurations are timed together, size by size. `on_done` is called after each line. A method
    that fails has no times, and the error as its note (`failed_rows`).
    """
    peaks = {bf16: peak_throughput(device, bf16) for bf16 in {c.bf16 for c in configurations}}
    names = list(dict.fromkeys(c.method for c in configurations))
    work = {each.job: each for each in LOCAL.map(partial(_count_work, device), names)}
    lines: list[dict[str, object]] = []
    for size in sizes:
        load = partial(_load, generated_clip(size, device), work, device)
        loaded = list(LOCAL.map(load, configurations))
        rows = [each.result().row for each in loaded if not each.error]
        for _ in range(len(loaded) - len(rows)):
            on_done()
        timings = iter(_time_rows(rows, device, repeats, on_done))
        for each in loaded:
            line = dict(zip(("method", "height", "width"), (each.job.row_name, *size), strict=True))
            timing = each.error or next(timings)
            if isinstance(timing, Exception):
                note = registry.failure_reason(each.job.method, timing)
                lines.append(line | {"note": note})
                continue
            counted = each.result().counted
            per_second = 1e6 * counted["multiply_adds"] * math.prod(size) / timing.inference.mean
            share = {"peak_share": per_second / peaks[each.job.bf16]}
            lines.append(line | _times(timing) | counted | share)
    return pd.DataFrame(lines, columns=list(COLUMNS))


def failed_rows(table: pd.DataFrame) -> dict[str, str]:
    """The rows of a table without times, and the error that is the reason."""
    failed = table[table["inference_ms"].isna()]
    return dict(zip(failed["method"], failed["note"], strict=True))


class _Work(NamedTuple):
    """What the networks of a method hold and compute."""

    parameters: int
    multiply_adds: float  # per pixel


class _Loaded(NamedTuple):
    """A row that can be timed, and its columns that need no clock."""

    row: TimedRow
    counted: dict[str, float]


def _count_work(device: torch.device, name: str, on_progress: ProgressCallback) -> _Work:
    method = Configuration(name).load(device)
    return _Work(count_parameters(method), count_multiply_adds(method, device))


def _load(
    clip: InMemoryClip,
    work: Mapping[str, JobResult[str, _Work]],
    device: torch.device,
    configuration: Configuration,
    on_progress: ProgressCallback,
) -> _Loaded:
    done = work[configuration.method].result()
    row = TimedRow(configuration.load(device), clip, SPP)
    counted = {
        "parameters": done.parameters / 1e3,
        "multiply_adds": done.multiply_adds / 1e3,
        "state_bytes": state_bytes(row.method, clip) / (clip.size.h * clip.size.w),
    }
    if configuration.backend == EAGER and device.type == "cpu":
        counted["memory_mb"] = peak_memory(row.method, clip) / 2**20
    return _Loaded(row, counted)


def _time_rows(
    rows: list[TimedRow], device: torch.device, repeats: int, on_done: Callable[[], None]
) -> list[Timing | Exception]:
    """The times of each row, or what it raised; each by itself if one ends them all."""

    def time(group: list[TimedRow], on_progress: ProgressCallback) -> list[Timing | Exception]:
        return time_methods(group, device, repeats, on_done=on_done)

    (together,) = LOCAL.map(time, [rows])
    if not together.error:
        return together.result()
    return [each.error or each.result()[0] for each in LOCAL.map(time, [[row] for row in rows])]


def peak_throughput(device: torch.device, bf16: bool) -> float:
    """Multiply-adds per second of a product of two matrices of 2048 x 2048."""
    dtype = torch.bfloat16 if bf16 else torch.float32
    a, b = torch.rand(2, PEAK_SIDE, PEAK_SIDE, device=device).to(dtype)
    clock, times = SystemClock(device), []
    for _ in range(PEAK_RUNS + 1):  # the first warms up
        start = clock.wall_ms()
        torch.mm(a, b)
        times.append(clock.wall_ms() - start)
    return PEAK_SIDE**3 / (statistics.median(times[1:]) / 1e3)


def _times(timing: Timing) -> dict[str, object]:
    return {
        "plan_ms": timing.plan.mean,
        "allocate_ms": timing.allocate.mean,
        "denoise_ms": timing.denoise.mean,
        "inference_ms": timing.inference.mean,
        "inference_p95_ms": timing.inference.p95,
        "note": f"{UNRELIABLE} {timing.unreliable}" if timing.unreliable else "",
    }
