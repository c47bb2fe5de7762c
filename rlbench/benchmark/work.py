"""What a method computes and holds, counted while it runs one frame; no clock is read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from rlbench.checks.tensors import iterate_parts, iterate_tensors
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Clip, GBuffer, Samples, Size
from rlbench.method import Method, State
from rlbench.run import run_clip
from rlbench.wrappers import MethodWrapper

__all__ = [
    "SPP",
    "count_multiply_adds",
    "count_parameters",
    "generated_clip",
    "peak_memory",
    "state_bytes",
]

FRAMES, SPP = 4, 1.0  # of the generated clip
COUNTED_SIDE = 96  # pixels, of the frame whose multiply-adds are counted; a multiple of 32


def generated_clip(size: tuple[int, int], device: torch.device) -> InMemoryClip:
    """The frames that methods are timed on, of `size` (height, width) pixels."""
    clip = procedural_clip(3, Size(1, *size), FRAMES, pool_spp=4, device=device)
    return InMemoryClip(f"{size[1]}x{size[0]}", clip.scene, clip.digest, list(clip))


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


def state_bytes(method: Method, clip: Clip) -> int:
    """Bytes of all tensors in the state after two frames."""
    keeping = _KeepingState(method, [])
    results = run_clip(keeping, clip, SPP)
    next(results), next(results)
    return sum(tensor.numel() * tensor.element_size() for tensor in iterate_tensors(keeping.states))


def peak_memory(method: Method, clip: Clip) -> int:
    """Most bytes that PyTorch had allocated at once during the second frame, less those before."""
    os.environ.setdefault("KINETO_LOG_LEVEL", "99")  # the profiler's log goes to the error stream
    results = run_clip(method, clip, SPP)
    next(results)
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
