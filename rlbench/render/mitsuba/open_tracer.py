"""Opens a scene with the tracer that suits this machine."""

from __future__ import annotations

import math

from rlbench.render.mitsuba.scalar import ScalarTracer
from rlbench.render.mitsuba.tracer import Tracer
from rlbench.render.mitsuba.variant import select_variant
from rlbench.render.mitsuba.wavefront import WavefrontTracer
from rlbench.render.scene import Scene

__all__ = [
    "ScalarTracer",
    "Tracer",
    "WavefrontTracer",
    "describe_tracer",
    "open_tracer",
    "sample_ms",
]


def open_tracer(
    scene: Scene, height: int, width: int, seed: int = 0, radiance_cap: float = math.inf
) -> Tracer:
    """A tracer of `scene`: wavefronts with LLVM or CUDA, else whole scalar images."""
    kind = ScalarTracer if select_variant().startswith("scalar") else WavefrontTracer
    return kind(scene, height, width, seed, radiance_cap)


def describe_tracer() -> str:
    """Variant and threads of this machine's tracer, on which its times depend."""
    variant = select_variant()
    import drjit as dr  # only now: it loads LLVM on import

    return variant if variant.startswith("cuda") else f"{variant}, {dr.thread_count()} threads"


def sample_ms(scene: Scene, height: int, width: int, repeats: int = 5) -> float:
    """Median milliseconds of one frame at one sample per pixel on this machine, after a warm-up."""
    return open_tracer(scene, height, width).measure_sample_ms(repeats)
