"""What every tracer does: a scene that moves, stacks of samples, means."""

from __future__ import annotations

import math
import statistics
import time as clock
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from rlbench.render.mitsuba import load
from rlbench.render.mitsuba.lights import EmitterScaler
from rlbench.render.pose import Pose
from rlbench.render.scene import Scene

MAX_PATHS = 2**20  # paths of one launch at most, each of about 100 bytes


class Tracer(ABC):
    """A scene in Mitsuba, seen through a pinhole of height x width pixels with a box filter.

    Streams are named in `rlbench.render.mitsuba.rng`; they are independent of each other, and so
    are the times and the samples of one stream. Radiance is linear, as the scene gives it.
    """

    def __init__(
        self, scene: Scene, height: int, width: int, seed: int = 0, radiance_cap: float = math.inf
    ) -> None:
        """Load `scene`; Mitsuba must be running. `seed` makes all of its streams other ones.

        A sample of any stream that is brighter than `cap` in a channel is dimmed to it, in its own
        colour: no fireflies, and a bias that inputs and references share. `cap` is in the scene's
        radiance, above 0.
        """
        self.scene, self.height, self.width, self.seed = scene, height, width, seed
        self.radiance_cap = radiance_cap
        import mitsuba as mi

        self.mi_scene = load.load_scene(scene)
        self.integrator = load.instantiate({"type": "path", "max_depth": scene.depth})
        self._parameters = mi.traverse(self.mi_scene)
        self._lights = EmitterScaler(self._parameters)
        self.set_time(0.0)

    def set_time(self, time: float) -> None:
        """Camera, vertices and lights as at `time`, in frames. Nothing is loaded again."""
        self.time, self.pose = float(time), Pose.at_time(self.scene, time)
        self._lights.set_factors(self.scene.lights(time))
        load.move_vertices(self._parameters, self.scene.vertex_animation(time), self.scene.meshes)
        self._update_camera()

    @abstractmethod
    def trace(
        self, pixels: Int[Array, " n"], samples: Int[Array, " n"], stream: str = "input"
    ) -> Float[Array, "n 3"]:
        """Radiance of any (pixel, sample) pairs; pixels count row by row from the upper left."""

    @abstractmethod
    def evaluate_rays(
        self, look: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The numbers that `look` finds along the ray of each film position.

        `film` is in pixels, x right and y down, from the upper left corner. `look` takes Mitsuba
        rays, be it one or a wavefront, and returns one number or Dr.Jit array for each quantity.
        """

    @abstractmethod
    def mesh_index(self, hit: Any) -> Any:
        """The place in `scene.meshes` of what a preliminary intersection has hit."""

    @abstractmethod
    def _update_camera(self) -> None:
        """Take over the camera of the new pose."""

    @abstractmethod
    def _trace_images(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        """`count` independent images, or fewer images of which each is a mean of several."""

    def trace_images(
        self, n: int, stream: str = "input", first: int = 0
    ) -> Float[Array, "n h w 3"]:
        """Samples `first` .. `first + n - 1` of every pixel: independent 1-spp images."""
        chunk = self._images_per_launch()
        return np.concatenate(
            [
                self._trace_images(start, min(chunk, first + n - start), stream)
                for start in range(first, first + n, chunk)
            ]
        )

    def mean(
        self,
        spp: int,
        stream: str,
        chunk: int | None = None,
        on_samples: Callable[[int], None] = lambda spp: None,
    ) -> Float[Array, "h w 3"]:
        """The mean of samples 0 .. spp - 1 of every pixel, in float32; see `total`."""
        return (self.trace_sum(spp, stream, 0, chunk, on_samples) / spp).astype(np.float32)

    def trace_sum(
        self,
        spp: int,
        stream: str,
        first: int = 0,
        chunk: int | None = None,
        on_samples: Callable[[int], None] = lambda spp: None,
    ) -> Float[Array, "h w 3"]:
        """The sum of samples `first` .. `first + spp - 1` of every pixel in float64, by launches.

        `traced` is told after each launch of at most `chunk` how many samples per pixel it had.
        """
        chunk = chunk or self._images_per_launch()
        total = np.zeros((self.height, self.width, 3))
        for start in range(first, first + spp, chunk):
            count = min(chunk, first + spp - start)
            total += self._trace_sum(start, count, stream)
            on_samples(count)
        return total

    def trace_moments(
        self, spp: int, stream: str, first: int = 0, chunk: int | None = None
    ) -> tuple[Float[Array, "h w 3"], Float[Array, "h w 3"]]:
        """Mean and variance of samples `first` .. `first + spp - 1` of every pixel, in float32.

        The variance is that of one sample, unbiased; over `spp` it is that of the mean. One sample
        has none, and it is NaN then.
        """
        chunk = chunk or self._images_per_launch()
        total = np.zeros((2, self.height, self.width, 3))  # of samples and of their squares
        for start in range(first, first + spp, chunk):
            images = self._trace_images(start, min(chunk, first + spp - start), stream)
            total[0] += images.sum(0, dtype=np.float64)
            total[1] += np.square(images, dtype=np.float64).sum(0)
        mean = total[0] / spp
        spread = np.maximum(total[1] / spp - mean**2, 0)  # rounding may make it negative
        variance = spread * (spp / (spp - 1) if spp > 1 else math.nan)
        return mean.astype(np.float32), variance.astype(np.float32)

    def measure_sample_ms(self, repeats: int = 5, spp: int = 1) -> float:
        """Median milliseconds of one full frame at one sample per pixel, after a warm-up.

        With `spp` samples a launch, as where many are wanted, it is the share of one of them.
        """
        self.trace_images(spp, "pilot")
        times = []
        for number in range(repeats):
            start = clock.perf_counter()
            self.trace_images(spp, "pilot", first=number)
            times.append(1e3 * (clock.perf_counter() - start) / spp)
        return statistics.median(times)

    def relative_cost(self, work: Callable[[], object], spp: int, warm_up: int = 2) -> float:
        """Time of `work` over that of `spp` samples per pixel.

        The median over three pairs that are taken one right after the other, so that it says the
        same whatever else the machine has to do.
        """

        def timed(work: Callable[[], object]) -> float:
            start = clock.perf_counter()
            work()
            return clock.perf_counter() - start

        pairs = [
            (timed(work), timed(lambda: self.trace_images(spp, "pilot")))
            for _ in range(warm_up + 3)
        ]
        return statistics.median(theirs / paths for theirs, paths in pairs[warm_up:])

    def apply_cap(self, radiance: Float[Array, "*shape 3"]) -> Float[Array, "*shape 3"]:
        """Samples dimmed to the cap; without a cap, untouched."""
        if self.radiance_cap == math.inf:
            return radiance
        brightest = radiance.max(-1, keepdims=True)
        return np.asarray(
            radiance * (self.radiance_cap / np.maximum(brightest, self.radiance_cap)), np.float32
        )

    def _trace_sum(self, first: int, count: int, stream: str) -> Float[Array, "h w 3"]:
        return np.asarray(self._trace_images(first, count, stream).sum(0, dtype=np.float64))

    def _images_per_launch(self) -> int:
        return max(1, MAX_PATHS // (self.height * self.width))
