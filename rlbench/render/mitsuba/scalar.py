"""The tracer for Mitsuba's scalar variant, without LLVM: whole images by Mitsuba's render loop."""

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

__all__ = ["ScalarTracer"]


class ScalarTracer(Tracer):
    """Renders whole images, each with a seed of its own.

    It is slower than `WavefrontTracer`, and arbitrary (pixel, sample) pairs cost whole images.
    Streams and samples are independent too. A mean over many samples is rendered at once, so it
    differs from the mean of the 1-spp images; its variance is the same.
    """

    def trace(
        self, pixels: Int[Array, " n"], samples: Int[Array, " n"], stream: str = "input"
    ) -> Float[Array, "n 3"]:
        """Radiance of any (pixel, sample) pairs, taken from whole images."""
        numbers, which = np.unique(samples, return_inverse=True)
        radiance = np.zeros((len(pixels), 3), np.float32)
        for i, number in enumerate(numbers):
            image = self._launch(int(number), 1, stream).reshape(-1, 3)
            radiance[which == i] = image[pixels[which == i]]
        return radiance

    def evaluate_rays(
        self, query: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The values of `query` for the ray through each film position, one ray at a time."""
        import mitsuba as mi

        origin = mi.Point3f([float(v) for v in self.pose.camera.origin])
        directions = self.pose.ray_directions(film, self.height, self.width)
        rays = (mi.RayDifferential3f(origin, mi.Vector3f(d.tolist())) for d in directions)
        return list(np.array([query(ray) for ray in rays]).T)

    def mesh_index(self, hit: Any) -> Any:
        """The index in `scene.meshes` of the shape that was hit; for others, one after the last."""
        if not hit.is_valid():
            return 0
        name = hit.shape.id() if hit.shape is not None else ""
        return self._index_of_name.get(name, len(self._index_of_name))

    @cached_property
    def _index_of_name(self) -> dict[str, int]:
        return {mesh.name: index for index, mesh in enumerate(self.scene.meshes)}

    def _update_camera(self) -> None:
        self._sensor = load.make_sensor(self.pose.camera, self.height, self.width)

    def _launch(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        images = [self._render(first + s, 1, stream) for s in range(count)]
        return self.apply_cap(np.stack(images))

    def _launch_sum(self, first: int, count: int, stream: str) -> Float[Array, "h w 3"]:
        if self.radiance_cap < math.inf:  # the cap applies to single samples
            return super()._launch_sum(first, count, stream)
        return self._render(first, count, stream).astype(np.float64) * count

    def _render(self, first: int, spp: int, stream: str) -> Float[Array, "h w 3"]:
        import mitsuba as mi

        low, high = rng.stream_key(stream, self.time, self.seed)
        seed = mi.sample_tea_32(low ^ first, high ^ spp)[0]
        image = mi.render(
            self.mi_scene, sensor=self._sensor, integrator=self.integrator, seed=seed, spp=spp
        )
        return np.array(image, np.float32).reshape(self.height, self.width, 3)
