"""Tracing without LLVM: whole images by Mitsuba's own loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from rlbench.render.mitsuba import load, rng
from rlbench.render.mitsuba.tracer import Tracer


class ScalarTracer(Tracer):
    """Traces without LLVM: Mitsuba renders whole images, each with a seed of its own.

    Slower, and arbitrary pairs cost whole images. Streams and samples are independent as well; the
    mean of many samples is rendered at once, so it is not the mean of the stack, only as good.
    """

    def trace(
        self, pixels: Int[Array, " n"], samples: Int[Array, " n"], stream: str = "input"
    ) -> Float[Array, "n 3"]:
        """Radiance of any (pixel, sample) pairs, picked from whole images."""
        wanted, which = np.unique(samples, return_inverse=True)
        radiance = np.zeros((len(pixels), 3), np.float32)
        for i, number in enumerate(wanted):
            image = self._trace_images(int(number), 1, stream).reshape(-1, 3)
            radiance[which == i] = image[pixels[which == i]]
        return radiance

    def evaluate_rays(
        self, look: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The numbers that `look` finds along the ray of each film position, one by one."""
        import mitsuba as mi

        origin = mi.Point3f([float(v) for v in self.pose.camera.origin])
        towards = self.pose.ray_directions(film, self.height, self.width)
        rays = (mi.RayDifferential3f(origin, mi.Vector3f(d.tolist())) for d in towards)
        return list(np.array([look(ray) for ray in rays]).T)

    def mesh_index(self, hit: Any) -> Any:
        """The place in `scene.meshes` of what a preliminary intersection has hit, or the next."""
        if not hit.is_valid():
            return 0
        name = hit.shape.id() if hit.shape is not None else ""
        return self._places.get(name, len(self._places))

    @cached_property
    def _places(self) -> dict[str, int]:
        return {m.name: i for i, m in enumerate(self.scene.meshes)}

    def _update_camera(self) -> None:
        self._sensor = load.make_sensor(self.pose.camera, self.height, self.width)

    def _trace_images(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        images = [self._image(first + s, 1, stream) for s in range(count)]
        return self.apply_cap(np.stack(images))

    def _trace_sum(self, first: int, count: int, stream: str) -> Float[Array, "h w 3"]:
        if self.radiance_cap < math.inf:  # each sample has to be seen
            return super()._trace_sum(first, count, stream)
        return self._image(first, count, stream).astype(np.float64) * count

    def _image(self, first: int, spp: int, stream: str) -> Float[Array, "h w 3"]:
        import mitsuba as mi

        low, high = rng.stream_key(stream, self.time, self.seed)
        seed = mi.sample_tea_32(low ^ first, high ^ spp)[0]
        image = mi.render(
            self.mi_scene, sensor=self._sensor, integrator=self.integrator, seed=seed, spp=spp
        )
        return np.array(image, np.float32).reshape(self.height, self.width, 3)
