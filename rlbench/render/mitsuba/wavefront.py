"""Tracing with LLVM or CUDA: any (pixel, sample) pairs in one wavefront."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from rlbench.render.mitsuba import load, rng
from rlbench.render.mitsuba.tracer import Tracer


class WavefrontTracer(Tracer):
    """Traces on LLVM or CUDA: a sample depends on (pixel, sample, time, stream, seed) only.

    Bit for bit so on one machine, whatever else is in the wavefront and in whatever order, but for
    one thing that is not ours: Mitsuba's integrator sends camera rays through Embree in coherent
    packets, and where a ray meets two triangles at the same distance, on an edge they share or
    where they coincide, Embree's choice depends on the packet. In the test scenes that is one
    sample in ten thousand, most of which differ in the last bits.
    """

    def trace(
        self, pixels: Int[Array, " n"], samples: Int[Array, " n"], stream: str = "input"
    ) -> Float[Array, "n 3"]:
        """Radiance of any (pixel, sample) pairs; the only function that calls the integrator."""
        import drjit as dr
        import mitsuba as mi

        if not len(pixels):
            return np.zeros((0, 3), np.float32)
        if len(pixels) == 1:  # one lane would be a scalar to Dr.Jit, and so another kernel
            return self.trace(np.repeat(pixels, 2), np.repeat(samples, 2), stream)[:1]
        pixel, sample = load.upload(mi.UInt32, pixels), load.upload(mi.UInt32, samples)
        numbers = self.make_sampler(pixel, sample, stream)
        jitter = numbers.next_2d()
        row = pixel // self._columns
        x, y = mi.Float(pixel - row * self._columns) + jitter.x, mi.Float(row) + jitter.y
        radiance, _, _ = self.integrator.sample(self.mi_scene, numbers, self.rays(x, y))
        dr.eval(radiance)  # at once, or reading the channels traces every path three times
        return self.apply_cap(np.stack([radiance[c].numpy() for c in range(3)], axis=-1))

    def evaluate_rays(
        self, look: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The numbers that `look` finds along the ray of each film position, in one kernel."""
        import drjit as dr
        import mitsuba as mi

        found = look(self.rays(*(load.upload(mi.Float, film[:, axis]) for axis in range(2))))
        dr.eval(*found)
        return [np.broadcast_to(quantity.numpy(), len(film)) for quantity in found]

    def mesh_index(self, hit: Any) -> Any:
        """The place in `scene.meshes` of what each preliminary intersection has hit.

        What is none of them, as most of a document is not, has the place after the last.
        """
        import drjit as dr
        import mitsuba as mi

        number: Any = dr.reinterpret_array(mi.UInt32, hit.shape)
        return dr.gather(mi.UInt32, self._places, number, hit.is_valid())

    def make_sampler(self, pixels: Any, samples: Any, stream: str) -> Any:
        """The sampler of a wavefront with these pixels and samples (mi.UInt32) at this time."""
        import drjit as dr
        import mitsuba as mi

        salt = [dr.opaque(mi.UInt32, k) for k in rng.stream_key(stream, self.time, self.seed)]
        return rng.make_sampler(pixels, samples, salt)

    def rays(self, x: Any, y: Any) -> Any:
        """The camera's rays through film positions (mi.Float), as in `each`."""
        import drjit as dr
        import mitsuba as mi

        origin, corner, across, down = self._lens
        return mi.RayDifferential3f(origin, dr.normalize(corner + across * x + down * y))

    @cached_property
    def _places(self) -> Any:
        """Mesh by the number that Dr.Jit has given its shape, which depends on what else lives."""
        import drjit as dr
        import mitsuba as mi

        names = [m.name for m in self.scene.meshes]
        shapes = self.mi_scene.shapes()
        pointers: list[Any] = [dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s)) for s in shapes]
        numbers = [int(pointer[0]) for pointer in pointers]
        known = {name: place for place, name in enumerate(names)}
        places = np.full(max([2, *numbers]) + 1, len(names), np.uint32)
        places[numbers] = [known.get(s.id(), len(names)) for s in shapes]
        return load.upload(mi.UInt32, places)

    def _update_camera(self) -> None:
        import drjit as dr
        import mitsuba as mi

        self._lens = load.pinhole_vectors(self.pose, self.height, self.width)
        self._columns = dr.opaque(mi.UInt32, self.width)

    def _trace_images(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        area = self.height * self.width
        # samples of a pixel side by side: their paths are alike, which Dr.Jit's vectors gain from
        pixels = np.repeat(np.arange(area, dtype=np.uint32), count)
        samples = np.tile(np.arange(first, first + count, dtype=np.uint32), area)
        radiance = self.trace(pixels, samples, stream)
        return np.moveaxis(radiance.reshape(self.height, self.width, count, 3), 2, 0)
