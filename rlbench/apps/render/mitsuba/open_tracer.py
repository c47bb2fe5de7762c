"""The tracers, and the one that suits this machine: wavefronts, or whole scalar images."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array
from torch import Tensor

from rlbench.apps.render.mitsuba import load
from rlbench.apps.render.mitsuba.tracer import Tracer, make_sampler, stream_key
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Scene


class WavefrontTracer(Tracer):
    """Traces wavefronts; a sample depends on (pixel, sample, time, stream, seed) only.

    On one machine samples are bit-identical, whatever else is in the wavefront and in any order,
    with one exception: Mitsuba's integrator sends camera rays through Embree in coherent packets,
    and where a ray meets two triangles at the same distance, on a shared edge or where they
    coincide, Embree's choice depends on the packet. In the test scenes this affects one sample in
    ten thousand, mostly in the last bits.
    """

    def trace(
        self, pixels: Int[Array, " n"], samples: Int[Array, " n"], stream: str = "input"
    ) -> Float[Array, "n 3"]:
        """Radiance of any (pixel, sample) pairs."""
        import mitsuba as mi

        if not len(pixels):
            return np.zeros((0, 3), np.float32)
        if len(pixels) == 1:  # Dr.Jit treats one lane as a scalar and would compile another kernel
            return self.trace(np.repeat(pixels, 2), np.repeat(samples, 2), stream)[:1]
        pixel, sample = load.upload(mi.UInt32, pixels), load.upload(mi.UInt32, samples)
        radiance = self._integrate(pixel, sample, stream)
        return self.apply_cap(np.stack([radiance[c].numpy() for c in range(3)], axis=-1))

    def trace_tensors(
        self, pixels: Int[Tensor, " n"], samples: Int[Tensor, " n"], stream: str = "input"
    ) -> Float[Tensor, "n 3"]:
        """As `trace`, of tensors. Nothing is copied to another device if both libraries have one.

        Never run on a GPU yet.
        """
        import drjit as dr
        import mitsuba as mi

        is_on_gpu = select_variant().startswith("cuda")
        if pixels.is_cuda != is_on_gpu or len(pixels) < 2:
            return super().trace_tensors(pixels, samples, stream)
        if is_on_gpu:  # Dr.Jit has a stream of its own
            torch.cuda.synchronize(pixels.device)
        pixel, sample = mi.UInt32(pixels.to(torch.int32)), mi.UInt32(samples.to(torch.int32))
        radiance = self._integrate(pixel, sample, stream)
        channels = [radiance[c].torch() for c in range(3)]
        dr.sync_thread()
        traced, cap = torch.stack(channels, -1), self.radiance_cap
        if cap == math.inf:
            return traced
        return traced * (cap / traced.amax(-1, keepdim=True).clamp_min(cap))

    def trace_frame(self, spp: int, stream: str = "pilot") -> list[Float[Tensor, "p 3"]]:
        """`spp` samples of every pixel, by launches; on a GPU they stay there.

        In each launch those of one pixel are together, as in `_launch`.
        """
        device = "cuda" if select_variant().startswith("cuda") else "cpu"
        pixels = torch.arange(self.height * self.width, device=device)
        radiance = []
        for first, count in self._launches(spp):
            samples = torch.arange(first, first + count, device=device).repeat(len(pixels))
            pairs = pixels.repeat_interleave(count), samples
            radiance.append(self.trace_tensors(*pairs, stream))
        return radiance

    def _integrate(self, pixel: Any, sample: Any, stream: str) -> Any:
        """Radiance of pairs (mi.UInt32), evaluated. No other function calls the integrator."""
        import drjit as dr
        import mitsuba as mi

        sampler = self.make_sampler(pixel, sample, stream)
        jitter = sampler.next_2d()
        row = pixel // self._columns
        x, y = mi.Float(pixel - row * self._columns) + jitter.x, mi.Float(row) + jitter.y
        radiance, _, _ = self.integrator.sample(self.mi_scene, sampler, self.rays(x, y))
        dr.eval(radiance)  # otherwise reading the channels traces every path three times
        return radiance

    def evaluate_rays(
        self, query: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The values of `query` for the ray through each film position, in one kernel."""
        import drjit as dr
        import mitsuba as mi

        values = query(self.rays(*(load.upload(mi.Float, film[:, axis]) for axis in range(2))))
        dr.eval(*values)
        return [np.broadcast_to(value.numpy(), len(film)) for value in values]

    def mesh_index(self, hit: Any) -> Any:
        """The index in `scene.meshes` of the shape in each preliminary intersection.

        Other shapes, such as most of those in an XML file, have the index after the last.
        """
        import drjit as dr
        import mitsuba as mi

        shape_id: Any = dr.reinterpret_array(mi.UInt32, hit.shape)
        return dr.gather(mi.UInt32, self._index_of_shape, shape_id, hit.is_valid())

    def make_sampler(self, pixels: Any, samples: Any, stream: str) -> Any:
        """The sampler of a wavefront of these pixels and samples (mi.UInt32) at this time."""
        import drjit as dr
        import mitsuba as mi

        key = [dr.opaque(mi.UInt32, k) for k in stream_key(stream, self.time, self.seed)]
        return make_sampler(pixels, samples, key)

    def rays(self, x: Any, y: Any) -> Any:
        """The camera rays through film positions (mi.Float), as in `evaluate_rays`."""
        import drjit as dr
        import mitsuba as mi

        origin, corner, across, down = self._pinhole
        return mi.RayDifferential3f(origin, dr.normalize(corner + across * x + down * y))

    @cached_property
    def _index_of_shape(self) -> Any:
        """Mesh index by Dr.Jit's shape id, which depends on other scenes in the process."""
        import drjit as dr
        import mitsuba as mi

        index_of_name = {mesh.name: index for index, mesh in enumerate(self.scene.meshes)}
        shapes = self.mi_scene.shapes()
        pointers: list[Any] = [dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s)) for s in shapes]
        ids = [int(pointer[0]) for pointer in pointers]
        other = len(index_of_name)
        indices = np.full(max([2, *ids]) + 1, other, np.uint32)
        indices[ids] = [index_of_name.get(shape.id(), other) for shape in shapes]
        return load.upload(mi.UInt32, indices)

    def _update_camera(self) -> None:
        import drjit as dr
        import mitsuba as mi

        self._pinhole = load.pinhole_vectors(self.pose, self.height, self.width)
        self._columns = dr.opaque(mi.UInt32, self.width)

    def _launch(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        area = self.height * self.width
        # samples of one pixel are neighbours: their paths are coherent, which Dr.Jit gains from
        pixels = np.repeat(np.arange(area, dtype=np.uint32), count)
        samples = np.tile(np.arange(first, first + count, dtype=np.uint32), area)
        radiance = self.trace(pixels, samples, stream)
        return np.moveaxis(radiance.reshape(self.height, self.width, count, 3), 2, 0)


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
        self._sensor = load.make_sensor(self.pose, self.height, self.width)

    def _launch(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        images = [self._render(first + s, 1, stream) for s in range(count)]
        return self.apply_cap(np.stack(images))

    def _launch_sum(self, first: int, count: int, stream: str) -> Float[Array, "h w 3"]:
        if self.radiance_cap < math.inf:  # the cap applies to single samples
            return super()._launch_sum(first, count, stream)
        return self._render(first, count, stream).astype(np.float64) * count

    def _render(self, first: int, spp: int, stream: str) -> Float[Array, "h w 3"]:
        import mitsuba as mi

        low, high = stream_key(stream, self.time, self.seed)
        seed = mi.sample_tea_32(low ^ first, high ^ spp)[0]
        image = mi.render(
            self.mi_scene, sensor=self._sensor, integrator=self.integrator, seed=seed, spp=spp
        )
        return np.array(image, np.float32).reshape(self.height, self.width, 3)


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
