"""Speed of methods by image size, backend and precision, on generated frames.

No score is measured. Times are those of `rlbench run`: interleaved rounds, with notes where the
machine was busy. Work and memory are counted by PyTorch while it runs one frame.
"""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from rlbench import registry
from rlbench.backends import EAGER, use_backend
from rlbench.benchmark.clock.stopwatch import SystemClock
from rlbench.benchmark.latency import REPEATS, TimedRow, Timing, time_methods
from rlbench.benchmark.results import UNRELIABLE
from rlbench.checks.tensors import iterate_parts, iterate_tensors
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import GBuffer, Samples, Size
from rlbench.method import Method, State
from rlbench.run import run_clip
from rlbench.wrappers import HalfPrecision, MethodWrapper

__all__ = [
    "COLUMNS",
    "SPP",
    "Configuration",
    "count_multiply_adds",
    "count_parameters",
    "generated_clip",
    "measure_speed",
]

FRAMES, SPP = 4, 1.0  # of the generated clip
COUNTED_SIDE = 96  # pixels, of the frame whose multiply-adds are counted; a multiple of 32
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
        method = registry.load_method(self.method, device, None if is_trained else "random")
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
    that fails has no times, and the error as its note.
    """
    peaks = {bf16: peak_throughput(device, bf16) for bf16 in {c.bf16 for c in configurations}}
    eager = {c.method: Configuration(c.method).load(device) for c in configurations}
    work = {name: count_multiply_adds(method, device) for name, method in eager.items()}
    lines: list[dict[str, object]] = []
    for size in sizes:
        clip = generated_clip(size, device)
        rows = [TimedRow(c.load(device), clip, SPP) for c in configurations]
        timings = time_methods(rows, device, repeats, on_done=on_done)
        for configuration, row, timing in zip(configurations, rows, timings, strict=True):
            line: dict[str, object] = {
                "method": configuration.row_name,
                "height": size[0],
                "width": size[1],
            }
            if isinstance(timing, Exception):
                lines.append({**line, "note": f"{type(timing).__name__}: {timing}"})
                continue
            multiply_adds = work[configuration.method]
            per_second = multiply_adds * size[0] * size[1] / (timing.inference.mean / 1e3)
            line |= _times(timing) | {
                "parameters": count_parameters(eager[configuration.method]) / 1e3,
                "multiply_adds": multiply_adds / 1e3,
                "peak_share": per_second / peaks[configuration.bf16],
                "state_bytes": _state_bytes(row) / (size[0] * size[1]),
            }
            if configuration.backend == EAGER and device.type == "cpu":
                line["memory_mb"] = _peak_memory(row) / 2**20
            lines.append(line)
    return pd.DataFrame(lines, columns=list(COLUMNS))


def count_multiply_adds(method: Method, device: torch.device) -> float:
    """Multiply-adds per pixel of all convolutions and matrix products in a frame with history."""
    clip = generated_clip((COUNTED_SIDE, COUNTED_SIDE), device)
    results = run_clip(method, clip, SPP)
    next(results)
    with FlopCounterMode(display=False) as counter:
        next(results)
    flops: int = counter.get_total_flops()
    return flops / 2 / COUNTED_SIDE**2


def count_parameters(method: Method) -> int:
    """Parameters of all networks of a method; 0 where a library holds them."""
    return sum(part.numel() for part in iterate_parts(method) if isinstance(part, nn.Parameter))


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


def generated_clip(size: PixelSize, device: torch.device) -> InMemoryClip:
    """The frames that methods are timed on, of `size` (height, width) pixels."""
    clip = procedural_clip(3, Size(1, *size), FRAMES, pool_spp=4, device=device)
    return InMemoryClip(f"{size[1]}x{size[0]}", clip.scene, clip.digest, list(clip))


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


def _state_bytes(row: TimedRow) -> int:
    """Bytes of all tensors in the state after two frames."""
    keeping = _KeepingState(row.method, [])
    results = run_clip(keeping, row.clip, row.target_spp)
    next(results), next(results)
    return sum(tensor.numel() * tensor.element_size() for tensor in iterate_tensors(keeping.states))


def _peak_memory(row: TimedRow) -> int:
    """Most bytes that PyTorch had allocated at once during the second frame, less those before."""
    os.environ.setdefault("KINETO_LOG_LEVEL", "99")  # the profiler's log goes to the error stream
    results = run_clip(row.method, row.clip, row.target_spp)
    next(results)
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiler:
        next(results)
    return max(_running_totals(profiler), default=0)


def _running_totals(profiler: profile) -> Iterator[int]:
    recorded: Any = profiler.profiler  # untyped: each allocation and release, in bytes
    events = [e for e in recorded.kineto_results.events() if e.name() == "[memory]"]
    total = 0
    for event in sorted(events, key=lambda event: event.start_ns()):
        total += event.nbytes()
        yield total
