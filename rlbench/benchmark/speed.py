"""Speed of methods by image size, backend and precision, on generated frames.

No score is measured. Times are those of `rlbench run`: interleaved rounds, with an interval and a
note where the machine was busy. Work and memory are counted by PyTorch while it runs one frame.
"""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.profiler import ProfilerActivity, profile
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import FlopCounterMode

from rlbench import registry
from rlbench.backends import EAGER
from rlbench.benchmark.clock import PARTS, SystemClock
from rlbench.benchmark.latency import REPEATS, TimedRow, Timing, device_name, time_methods
from rlbench.benchmark.results import HALF, interval_columns, mark_uncertainty, uncertainty
from rlbench.benchmark.run_plan import build_method
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import RlbenchError
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.method import Method, State
from rlbench.ops.nested_tensors import iterate_parts, iterate_tensors
from rlbench.parallel.executor import LOCAL, JobResult, ProgressCallback
from rlbench.run import run_clip
from rlbench.system import provenance
from rlbench.system.half_precision import half_dtype
from rlbench.wrappers import MethodWrapper

PEAK_SIDE, COPIED_BYTES = 2048, 2**28  # of the product and the copy that stand for peaks
PEAK_RUNS = 5
COLUMNS = {
    "method": "row name, with backend and precision",
    "height": "pixels",
    "width": "pixels",
    "plan_ms": "mean of the middle half of the frames",
    "allocate_ms": "likewise",
    "denoise_ms": "likewise",
    "inference_ms": "sum of the three",
    "inference_low_ms": "low end of the interval in which a quiet machine's time lies",
    "inference_high_ms": "high end of it",
    "inference_p95_ms": "95th percentile",
    "first_use_ms": "of the first frames beyond later ones: loading, recording, compiling",
    "parameters": "thousands, of the networks that PyTorch runs",
    "multiply_adds": "thousands per pixel, of convolutions and matrix products",
    "peak_share": "of the throughput of a matrix product in the same precision",
    "traffic_bytes": "per pixel, read and written by PyTorch's operations one by one, in a frame",
    "bandwidth_share": "of the bytes that a copy reads and writes in the same time",
    "state_bytes": "per pixel, of all tensors that are kept for the next frame",
    "memory_mb": "most memory of tensors during a frame, beyond its input",
    "note": "why an interval is wide, or why there are no times",
}

PixelSize = tuple[int, int]  # height, width
_Counts = dict[str, float]  # columns that need no clock
SHOWN = {
    "method": "method",
    "plan_ms": "plan, ms",
    "allocate_ms": "allocate",
    "denoise_ms": "denoise",
    "inference_ms": "inference",
    "inference_p95_ms": "p95",
    "first_use_ms": "first use",
    "parameters": "thousand parameters",
    "multiply_adds": "thousand multiply-adds / pixel",
    "peak_share": "share of peak",
    "traffic_bytes": "bytes moved / pixel",
    "bandwidth_share": "share of bandwidth",
    "state_bytes": "bytes of state / pixel",
    "memory_mb": "memory, MiB",
}
SHARES = ("peak_share", "bandwidth_share")
COUNTS = ("first_use_ms", "parameters", "traffic_bytes", "state_bytes", "memory_mb")
DECIMALS = dict.fromkeys(SHARES, 2) | dict.fromkeys(COUNTS, 0)  # else 1
FRAMES, SPP = 4, 1.0  # of the generated clip
COUNTED_SIDE = 96  # pixels, of the frame whose multiply-adds are counted; a multiple of 32


@dataclass(frozen=True)
class Configuration:
    """A method, what runs its networks, and in which precision."""

    method: str
    backend: str = EAGER
    half: bool = False  # networks in half precision

    @property
    def row_name(self) -> str:
        """The name as in the results."""
        parts = [self.backend] * (self.backend != EAGER) + [HALF] * self.half
        return "@".join(filter(None, (self.method, "-".join(parts))))

    def load(self, device: torch.device) -> Method:
        """The method with its shipped weights, or random ones: they change no time."""
        weights = None if registry.get_variant(self.method).pretrained else "random"
        return build_method(self.method, device, weights, backend=self.backend, half=self.half)


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
    dtypes = {c: half_dtype(device) if c.half else torch.float32 for c in configurations}
    peaks = {dtype: peak_throughput(device, dtype) for dtype in set(dtypes.values())}
    bandwidth = peak_bandwidth(device)
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
            per_second = 1e3 * math.prod(size) / timing.inference.mean  # pixels
            share = {
                "peak_share": 1e3 * counted["multiply_adds"] * per_second / peaks[dtypes[each.job]],
                "bandwidth_share": counted["traffic_bytes"] * per_second / bandwidth,
            }
            lines.append(line | _times(timing) | counted | share)
    return pd.DataFrame(lines, columns=list(COLUMNS))


def failed_rows(table: pd.DataFrame) -> dict[str, str]:
    """The rows of a table without times, and the error that is the reason."""
    failed = table[table["inference_ms"].isna()]
    return dict(zip(failed["method"], failed["note"], strict=True))


def profile_times(table: pd.DataFrame) -> dict[str, dict[str, float]]:
    """The inference times of a table by size, as in "1920x1080", and row.

    Raises RlbenchError if there is no time.
    """
    timed = table[table["inference_ms"].notna()]
    if timed.empty:
        raise RlbenchError(f"no row has a time, of {len(table)}: {table['note'].iloc[0]}")
    return {
        f"{width}x{height}": dict(
            zip(rows["method"], map(float, rows["inference_ms"]), strict=True)
        )
        for (height, width), rows in timed.groupby(["height", "width"])
    }


class _Loaded(NamedTuple):
    """A row that can be timed, and its columns that need no clock."""

    row: TimedRow
    counted: _Counts


def _count_work(device: torch.device, name: str, on_progress: ProgressCallback) -> _Counts:
    """Thousands of parameters, and of multiply-adds per pixel; bytes moved per pixel."""
    method = Configuration(name).load(device)
    multiply_adds, moved = count_work(method, device)
    return {
        "parameters": count_parameters(method) / 1e3,
        "multiply_adds": multiply_adds / 1e3,
        "traffic_bytes": moved,
    }


def _load(
    clip: InMemoryClip,
    work: Mapping[str, JobResult[str, _Counts]],
    device: torch.device,
    configuration: Configuration,
    on_progress: ProgressCallback,
) -> _Loaded:
    counted = dict(work[configuration.method].result())
    method = configuration.load(device)
    row = TimedRow(method, clip, timed_spp(method))
    counted["state_bytes"] = state_bytes(row.method, clip) / (clip.size.h * clip.size.w)
    if configuration.backend == EAGER:
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


def peak_throughput(device: torch.device, dtype: torch.dtype) -> float:
    """Multiply-adds per second of a product of two matrices of 2048 x 2048."""
    a, b = torch.rand(2, PEAK_SIDE, PEAK_SIDE, device=device).to(dtype)
    return PEAK_SIDE**3 / _median_seconds(lambda: torch.mm(a, b), device)


def peak_bandwidth(device: torch.device) -> float:
    """Bytes per second that a copy of 256 MiB reads and writes."""
    source = torch.zeros(COPIED_BYTES // 4, device=device)
    target = torch.empty_like(source)
    return 2 * COPIED_BYTES / _median_seconds(lambda: target.copy_(source), device)


def _median_seconds(work: Callable[[], object], device: torch.device) -> float:
    clock, times = SystemClock(device), []
    for _ in range(PEAK_RUNS + 1):  # the first warms up
        start = clock.wall_ms()
        work()
        times.append(clock.wall_ms() - start)
    return statistics.median(times[1:]) / 1e3


def _times(timing: Timing) -> dict[str, object]:
    return {
        **{f"{name}_ms": getattr(timing, name).mean for name in (*PARTS, "inference")},
        "inference_p95_ms": timing.inference.p95,
        "inference_low_ms": timing.low,
        "inference_high_ms": timing.high,
        "first_use_ms": timing.first_use_ms,
        "note": timing.disturbance,
    }


def write_speed(table: pd.DataFrame, device: torch.device, out: Path) -> list[Path]:
    """Write speed.csv and speed.md into a folder; returns both."""
    out.mkdir(parents=True, exist_ok=True)
    rows, page = out / "speed.csv", out / "speed.md"
    table.to_csv(rows, index=False)
    described = f"{device_name(device)}, {provenance.compute_software(device.type)}"
    page.write_text(speed_page(table, described), encoding="utf-8")
    return [rows, page]


def speed_page(table: pd.DataFrame, device: str) -> str:
    """A Markdown page with one table per size."""
    legend = "; ".join(f"*{SHOWN[name]}*: {COLUMNS[name]}" for name in list(SHOWN)[1:])
    parts = [
        "# Speed of methods",
        f"One frame at 1 spp, or the least that a row takes, generated, on {device}. {legend}.",
    ]
    for (height, width), rows in table.groupby(["height", "width"], sort=False):
        parts += [f"## {width} x {height}", *_lines(rows)]
    return "\n\n".join(parts) + "\n"


def _lines(rows: pd.DataFrame) -> list[str]:
    table = [list(SHOWN.values()), ["---", *["---:"] * (len(SHOWN) - 1)]]
    for _, row in rows.iterrows():
        numbers = {name: _format(name, row[name]) for name in list(SHOWN)[1:]}
        ends = uncertainty(*row[list(interval_columns("inference"))])
        numbers["inference_ms"] += mark_uncertainty(ends)
        table.append([f"`{row['method']}`", *numbers.values()])
    noted = rows[rows["note"] != ""]
    notes = [f"`{row['method']}`: {row['note']}" for _, row in noted.iterrows()]
    return ["\n".join(f"| {' | '.join(cells)} |" for cells in table), *notes]


def _format(name: str, value: float) -> str:
    return "" if pd.isna(value) else f"{value:.{DECIMALS.get(name, 1)}f}"


def generated_clip(size: tuple[int, int], device: torch.device) -> InMemoryClip:
    """The frames that methods are timed on, of `size` (height, width) pixels."""
    clip = procedural_clip(3, Size(1, *size), FRAMES, pool_spp=4, device=device)
    return InMemoryClip(f"{size[1]}x{size[0]}", clip.scene, clip.digest, list(clip))


def timed_spp(method: Method) -> float:
    """The budget of a timed frame: 1 spp, or the least that the method takes."""
    return max(SPP, float(method.traits.min_samples))


class Work(NamedTuple):
    """What a frame with history computes and moves, per pixel."""

    multiply_adds: float  # of all convolutions and matrix products
    traffic_bytes: float  # that the operations read and write, each for itself


def count_work(method: Method, device: torch.device) -> Work:
    """The work of a method in the second frame of a small clip."""
    clip = generated_clip((COUNTED_SIDE, COUNTED_SIDE), device)
    results = run_clip(method, clip, timed_spp(method))
    next(results)
    with FlopCounterMode(display=False) as counter, TrafficCounter() as traffic:
        next(results)
    flops: int = counter.get_total_flops()
    return Work(flops / 2 / COUNTED_SIDE**2, traffic.total / COUNTED_SIDE**2)


class TrafficCounter(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Counts the bytes of what operations read and write; views move none."""

    def __init__(self) -> None:
        """Begin with no bytes."""
        super().__init__()  # type: ignore[no-untyped-call]
        self.total = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """What the operation returns."""
        result = func(*args, **(kwargs or {}))
        returns = (each.alias_info for each in func._schema.returns)
        is_view = any(alias is not None and not alias.is_write for alias in returns)
        if not is_view and "empty" not in func.name():
            values = tree_leaves((args, kwargs, result))
            self.total += sum(_stored_bytes(v) for v in values if isinstance(v, Tensor))
        return result


def _stored_bytes(tensor: Tensor) -> int:
    """Bytes of its values; an expanded tensor has less memory than values."""
    return min(tensor.numel() * tensor.element_size(), tensor.untyped_storage().nbytes())


def count_parameters(method: Method) -> int:
    """Parameters of all networks of a method; 0 where a library holds them."""
    return sum(part.numel() for part in iterate_parts(method) if isinstance(part, nn.Parameter))


def state_bytes(method: Method, clip: Clip) -> int:
    """Bytes of all tensors in the state after two frames."""
    keeping = _KeepingState(method, [])
    results = run_clip(keeping, clip, timed_spp(method))
    next(results), next(results)
    return sum(tensor.numel() * tensor.element_size() for tensor in iterate_tensors(keeping.states))


def peak_memory(method: Method, clip: Clip) -> int:
    """Most bytes that PyTorch had allocated at once during the second frame, less those before."""
    os.environ.setdefault("KINETO_LOG_LEVEL", "99")  # the profiler's log goes to the error stream
    results = run_clip(method, clip, timed_spp(method))
    next(results)
    device = next(iter(clip)).gbuffer.normal.device
    if device.type == "cuda":
        before = torch.cuda.memory_allocated(device)
        torch.cuda.reset_peak_memory_stats(device)
        next(results)
        return torch.cuda.max_memory_allocated(device) - before
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiler:
        next(results)
    return max(_running_totals(profiler), default=0)


@dataclass(frozen=True)
class _KeepingState(MethodWrapper[Method]):
    """Keeps the last state, to count its bytes."""

    states: list[object]

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The wrapped method's image, and the next state."""
        image, state = super().denoise(gbuffer, samples, state)
        self.states[:] = [state]
        return image, state


def _running_totals(profiler: profile) -> Iterator[int]:
    recorded: Any = profiler.profiler  # untyped: each allocation and release, in bytes
    events = [e for e in recorded.kineto_results.events() if e.name() == "[memory]"]
    total = 0
    for event in sorted(events, key=lambda event: event.start_ns()):
        total += event.nbytes()
        yield total
