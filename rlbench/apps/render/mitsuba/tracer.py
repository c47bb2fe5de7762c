"""The base of all tracers: an animated scene, independent 1-spp images, and their mean.

Random numbers depend on pixel, sample, frame, stream and seed only.
"""

from __future__ import annotations

import gc
import hashlib
import math
import statistics
import struct
import time as clock
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array
from torch import Tensor

from rlbench.apps.render.mitsuba import load
from rlbench.apps.render.mitsuba.load import EmitterScaler
from rlbench.apps.render.scene import Pose, Scene

MAX_PATHS = 2**20  # per launch; a path needs about 100 bytes
STREAMS = ("input", "pilot", "referenceA", "referenceB", "restir")


class Tracer(ABC):
    """A scene in Mitsuba with a pinhole camera of height x width pixels and a box filter.

    Sample streams are listed in STREAMS. They are independent of each other, as are the times and
    the samples of one stream. Radiance is linear and not exposed.
    """

    def __init__(
        self, scene: Scene, height: int, width: int, seed: int = 0, radiance_cap: float = math.inf
    ) -> None:
        """Load `scene`; a Mitsuba variant must be set. Each `seed` gives other samples.

        A sample that exceeds `radiance_cap` > 0 in a channel is scaled down to it, which keeps its
        hue. This removes fireflies and biases inputs and references alike. The cap is in units of
        the scene's radiance, before exposure.
        """
        self.scene, self.height, self.width, self.seed = scene, height, width, seed
        self.radiance_cap = radiance_cap
        import mitsuba as mi

        gc.collect()  # while an old scene is alive, Dr.Jit compiles kernels for the next one again
        self.mi_scene = load.load_scene(scene)
        self.integrator = load.instantiate({"type": "path", "max_depth": scene.max_depth})
        self._parameters = mi.traverse(self.mi_scene)
        self._lights = EmitterScaler(self._parameters)
        self.set_time(0.0)

    def set_time(self, time: float) -> None:
        """Move camera, vertices and lights to `time`, in frames. Nothing is loaded again."""
        self.time, self.pose = float(time), Pose.at_time(self.scene, time)
        self._lights.set_factors(self.scene.lights(time))
        load.move_vertices(self._parameters, self.scene.vertex_animation(time), self.scene.meshes)
        self._update_camera()

    @abstractmethod
    def trace(
        self, pixels: Int[Array, " n"], samples: Int[Array, " n"], stream: str = "input"
    ) -> Float[Array, "n 3"]:
        """Radiance of any (pixel, sample) pairs; pixels count row by row from the upper left."""

    def trace_tensors(
        self, pixels: Int[Tensor, " n"], samples: Int[Tensor, " n"], stream: str = "input"
    ) -> Float[Tensor, "n 3"]:
        """As `trace`, of tensors; the radiance is on their device."""
        radiance = self.trace(pixels.cpu().numpy(), samples.cpu().numpy(), stream)
        return torch.from_numpy(radiance).to(pixels.device)

    @abstractmethod
    def evaluate_rays(
        self, query: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The values that `query` computes for the camera ray through each film position.

        `film` is in pixels, x right and y down, 0 at the upper left corner. `query` takes one
        Mitsuba ray or a wavefront of rays, and returns one number or Dr.Jit array per quantity.
        """

    @abstractmethod
    def mesh_index(self, hit: Any) -> Any:
        """The index in `scene.meshes` of the shape in a preliminary intersection."""

    @abstractmethod
    def _update_camera(self) -> None:
        """Take over the camera of the new pose."""

    @abstractmethod
    def _launch(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        """1-spp images of samples `first` to `first + count - 1`."""

    def trace_images(self, n: int, stream: str = "input") -> Float[Array, "n h w 3"]:
        """Independent 1-spp images: samples 0 to n - 1 of every pixel."""
        return np.concatenate([self._launch(*samples, stream) for samples in self._launches(n)])

    def trace_frame(self, spp: int, stream: str = "pilot") -> object:
        """`spp` samples of every pixel, left where they are traced: what a time of samples is."""
        return self.trace_images(spp, stream)

    def trace_mean(
        self,
        spp: int,
        stream: str,
        chunk: int | None = None,
        on_samples: Callable[[int], None] = lambda spp: None,
    ) -> Float[Array, "h w 3"]:
        """The mean of samples 0 to spp - 1 of every pixel, in float32; see `trace_sum`."""
        return (self.trace_sum(spp, stream, 0, chunk, on_samples) / spp).astype(np.float32)

    def trace_sum(
        self,
        spp: int,
        stream: str,
        first: int = 0,
        chunk: int | None = None,
        on_samples: Callable[[int], None] = lambda spp: None,
    ) -> Float[Array, "h w 3"]:
        """The sum of samples `first` to `first + spp - 1` of every pixel, in float64.

        A launch traces at most `chunk` samples per pixel; `on_samples` receives their number.
        """
        chunk = chunk or self._images_per_launch()
        total = np.zeros((self.height, self.width, 3))
        for start in range(first, first + spp, chunk):
            count = min(chunk, first + spp - start)
            total += self._launch_sum(start, count, stream)
            on_samples(count)
        return total

    def measure_sample_ms(self, repeats: int = 5, spp: int = 1) -> float:
        """Median milliseconds of one frame at one sample per pixel, after a warm-up.

        With `spp` > 1, the time of a launch of that many samples, divided by their number.
        """
        times = self.measure_ms(lambda: self.trace_frame(spp), repeats)
        return statistics.median(times) / spp

    def measure_ms(self, work: Callable[[], object], repeats: int) -> list[float]:
        """Milliseconds of each repetition of `work`, after a warm-up."""
        work()
        times = []
        for _ in range(repeats):
            start = clock.perf_counter()
            work()
            times.append(1e3 * (clock.perf_counter() - start))
        return times

    def relative_cost(self, work: Callable[[], object], spp: int, warm_up: int = 2) -> float:
        """Time of `work` divided by that of `spp` samples per pixel.

        The median of three pairs, each measured back to back, so that other load on the machine
        slows both alike.
        """

        def seconds(work: Callable[[], object]) -> float:
            start = clock.perf_counter()
            work()
            return clock.perf_counter() - start

        pairs = [
            (seconds(work), seconds(lambda: self.trace_frame(spp))) for _ in range(warm_up + 3)
        ]
        return statistics.median(work_s / paths_s for work_s, paths_s in pairs[warm_up:])

    def apply_cap(self, radiance: Float[Array, "*shape 3"]) -> Float[Array, "*shape 3"]:
        """Samples scaled down to the radiance cap; unchanged without a cap."""
        cap = self.radiance_cap
        if cap == math.inf:
            return radiance
        brightest = radiance.max(-1, keepdims=True)
        return np.asarray(radiance * (cap / np.maximum(brightest, cap)), np.float32)

    def _launch_sum(self, first: int, count: int, stream: str) -> Float[Array, "h w 3"]:
        """The sum of the images of one launch, in float64."""
        return np.asarray(self._launch(first, count, stream).sum(0, dtype=np.float64))

    def _launches(self, n: int) -> Iterator[tuple[int, int]]:
        """First sample and number of samples of each launch, for samples 0 to n - 1."""
        chunk = self._images_per_launch()
        return ((start, min(chunk, n - start)) for start in range(0, n, chunk))

    def _images_per_launch(self) -> int:
        return max(1, MAX_PATHS // (self.height * self.width))


def stream_key(stream: str, time: float, seed: int) -> tuple[int, int]:
    """Two 32-bit numbers for one stream of one frame; no two streams share them.

    `time` is in frames and may be fractional. Raises LookupError for an unknown stream.
    """
    if stream not in STREAMS:
        raise LookupError(f"no sample stream '{stream}'; available: {', '.join(STREAMS)}")
    text = f"{stream} {seed} {float(time)!r}".encode()
    return struct.unpack("<II", hashlib.blake2b(text, digest_size=8).digest())


def make_sampler(pixels: Any, samples: Any, key: Any) -> Any:
    """A Mitsuba sampler for a wavefront whose lanes are `pixels` and `samples` (mi.UInt32).

    `key` holds the two numbers of `stream_key`, opaque to the compiler. Mitsuba's own `independent`
    sampler is keyed by the lane, so a sample's value would change with the wavefront around it.
    """
    return _sampler_class()(pixels, samples, key)


@cache
def _sampler_class() -> type:
    import mitsuba as mi  # the class can be defined only after a variant is set

    class KeyedSampler(mi.Sampler):
        """A PCG32 for each lane; two rounds of TEA give its sequence and its initial state.

        TEA (Wheeler and Needham 1994) maps 64 bits to 64 bits one to one, so no two (pixel, sample)
        pairs of a frame start alike.
        """

        def __init__(self, pixels: Any, samples: Any, key: Any) -> None:
            super().__init__(mi.Properties())
            self.lanes = len(pixels)
            high, low = mi.sample_tea_32(pixels, samples)
            sequence = (mi.UInt64(high) << 32) | mi.UInt64(low)
            high, low = mi.sample_tea_32(high ^ key[0], low ^ key[1])
            generator: Any = mi.PCG32
            self.rng = generator()
            self.rng.seed((mi.UInt64(high) << 32) | mi.UInt64(low), sequence)

        def next_1d(self, active: Any = True) -> Any:
            return self.rng.next_float32(active)

        def next_2d(self, active: Any = True) -> Any:
            first = self.rng.next_float32(active)
            return mi.Point2f(first, self.rng.next_float32(active))

        def wavefront_size(self) -> int:
            return self.lanes

        def schedule_state(self) -> None:
            import drjit as dr

            dr.schedule(self.rng.state, self.rng.inc)

        def traverse(self, callback: Any) -> None:
            callback.put("rng", self.rng, mi.ParamFlags.NonDifferentiable)

    return KeyedSampler
