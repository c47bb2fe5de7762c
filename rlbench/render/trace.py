"""Tracing any (pixel, sample) pairs of a scene that moves."""

from __future__ import annotations

import statistics
import time as clock
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from rlbench.render import llvm, load, sampler
from rlbench.render.pose import Pose
from rlbench.render.scene import Scene

LANES = 2**20  # paths of one launch at most, each of about 100 bytes


def open_tracer(scene: Scene, height: int, width: int, seed: int = 0) -> Tracer:
    """A tracer of `scene` for this machine: wavefronts with LLVM or CUDA, else whole images."""
    kind = Whole if llvm.activate().startswith("scalar") else Wavefront
    return kind(scene, height, width, seed)


def sample_ms(scene: Scene, height: int, width: int, repeats: int = 5) -> float:
    """Median milliseconds of one full frame at one sample per pixel on this machine, warmed up."""
    return open_tracer(scene, height, width).sample_ms(repeats)


class Tracer(ABC):
    """A scene in Mitsuba, seen through a pinhole of height x width pixels with a box filter.

    Streams are named in `rlbench.render.sampler`; they are independent of each other, and so are
    the times and the samples of one stream. Radiance is linear, as the scene gives it.
    """

    def __init__(self, scene: Scene, height: int, width: int, seed: int = 0) -> None:
        self.scene, self.height, self.width, self.seed = scene, height, width, seed
        import mitsuba as mi

        self.mitsuba = load.load(scene)
        self.integrator = load.plugin({"type": "path", "max_depth": scene.depth})
        self._parameters = mi.traverse(self.mitsuba)
        self.set_time(0.0)

    def set_time(self, time: float) -> None:
        """Move camera and vertices to `time`, in frames. Nothing is loaded or compiled again."""
        self.time, self.pose = float(time), Pose.of(self.scene, time)
        moved = self.scene.moving(time)
        for name, vertices in moved.items():
            load.assign(self._parameters, f"{name}.vertex_positions", vertices)
        if moved:
            self._parameters.update()
        self._look()

    @abstractmethod
    def trace(
        self, pixels: Int[Array, " n"], samples: Int[Array, " n"], stream: str = "input"
    ) -> Float[Array, "n 3"]:
        """Radiance of any (pixel, sample) pairs; pixels count row by row from the upper left."""

    @abstractmethod
    def each(
        self, look: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The numbers that `look` finds along the ray of each film position.

        `film` is in pixels, x right and y down, from the upper left corner. `look` takes Mitsuba
        rays, be it one or a wavefront, and returns one number or Dr.Jit array for each quantity.
        """

    @abstractmethod
    def mesh(self, hit: Any) -> Any:
        """The place in `scene.meshes` of what a preliminary intersection has hit."""

    @abstractmethod
    def _look(self) -> None:
        """Take over the camera of the new pose."""

    @abstractmethod
    def _launch(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        """`count` independent images, or fewer images of which each is a mean of several."""

    def stack(self, n: int, stream: str = "input", first: int = 0) -> Float[Array, "n h w 3"]:
        """Samples `first` .. `first + n - 1` of every pixel: independent 1-spp images."""
        chunk = self._chunk()
        return np.concatenate(
            [
                self._launch(start, min(chunk, first + n - start), stream)
                for start in range(first, first + n, chunk)
            ]
        )

    def mean(
        self,
        spp: int,
        stream: str,
        chunk: int | None = None,
        traced: Callable[[int], None] = lambda spp: None,
    ) -> Float[Array, "h w 3"]:
        """The mean of samples 0 .. spp - 1 of every pixel, summed in float64, `chunk` a launch.

        `traced` is told after each launch how many samples per pixel it had.
        """
        chunk = chunk or self._chunk()
        total = np.zeros((self.height, self.width, 3))
        for start in range(0, spp, chunk):
            count = min(chunk, spp - start)
            total += self._sum(start, count, stream)
            traced(count)
        return (total / spp).astype(np.float32)

    def sample_ms(self, repeats: int = 5) -> float:
        """Median milliseconds of one full frame at one sample per pixel, after a warm-up."""
        self.stack(1, "pilot")
        times = []
        for number in range(repeats):
            start = clock.perf_counter()
            self.stack(1, "pilot", first=number)
            times.append(1e3 * (clock.perf_counter() - start))
        return statistics.median(times)

    def _sum(self, first: int, count: int, stream: str) -> Float[Array, "h w 3"]:
        return np.asarray(self._launch(first, count, stream).sum(0, dtype=np.float64))

    def _chunk(self) -> int:
        return max(1, LANES // (self.height * self.width))


class Wavefront(Tracer):
    """Traces on LLVM or CUDA: a sample depends on (pixel, sample, time, stream, seed) only.

    Bit for bit so on one machine, whatever else is in the wavefront and in whatever order.
    """

    def trace(
        self, pixels: Int[Array, " n"], samples: Int[Array, " n"], stream: str = "input"
    ) -> Float[Array, "n 3"]:
        """Radiance of any (pixel, sample) pairs; the only function that calls the integrator."""
        import drjit as dr
        import mitsuba as mi

        n = len(pixels)
        if n < 2:  # one lane would be a scalar to Dr.Jit, and so another kernel; none is an error
            some = [np.resize(np.append(a, np.uint32(0)), 2) for a in (pixels, samples)]
            return self.trace(some[0], some[1], stream)[:n]
        pixel, sample = load.upload(mi.UInt32, pixels), load.upload(mi.UInt32, samples)
        salt = [dr.opaque(mi.UInt32, k) for k in sampler.key(stream, self.time, self.seed)]
        numbers = sampler.keyed(pixel, sample, salt)
        jitter = numbers.next_2d()
        row = pixel // self._columns
        x, y = mi.Float(pixel - row * self._columns) + jitter.x, mi.Float(row) + jitter.y
        radiance, _, _ = self.integrator.sample(self.mitsuba, numbers, self._rays(x, y))
        dr.eval(radiance)  # at once, or reading the channels traces every path three times
        return np.stack([radiance[c].numpy() for c in range(3)], axis=-1)

    def each(
        self, look: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The numbers that `look` finds along the ray of each film position, in one kernel."""
        import drjit as dr
        import mitsuba as mi

        found = look(self._rays(*(load.upload(mi.Float, film[:, axis]) for axis in range(2))))
        dr.eval(*found)
        return [np.broadcast_to(quantity.numpy(), len(film)) for quantity in found]

    def mesh(self, hit: Any) -> Any:
        """The place in `scene.meshes` of what each preliminary intersection has hit."""
        import drjit as dr
        import mitsuba as mi

        number = dr.reinterpret_array(mi.UInt32, hit.shape)
        return dr.gather(mi.UInt32, self._places, number, hit.is_valid())

    def _rays(self, x: Any, y: Any) -> Any:
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
        shapes = self.mitsuba.shapes()
        numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]) for s in shapes]
        places = np.zeros(max(2, *numbers) + 1, np.uint32)
        places[numbers] = [names.index(s.id()) for s in shapes]
        return load.upload(mi.UInt32, places)

    def _look(self) -> None:
        import drjit as dr
        import mitsuba as mi

        self._lens = load.lens(self.pose, self.height, self.width)
        self._columns = dr.opaque(mi.UInt32, self.width)

    def _launch(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        area = self.height * self.width
        pixels = np.tile(np.arange(area, dtype=np.uint32), count)
        samples = np.repeat(np.arange(first, first + count, dtype=np.uint32), area)
        return self.trace(pixels, samples, stream).reshape(count, self.height, self.width, 3)


class Whole(Tracer):
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
            image = self._image(int(number), 1, stream).reshape(-1, 3)
            radiance[which == i] = image[pixels[which == i]]
        return radiance

    def each(
        self, look: Callable[[Any], Sequence[Any]], film: Float[Array, "p 2"]
    ) -> list[Float[Array, " p"]]:
        """The numbers that `look` finds along the ray of each film position, one by one."""
        import mitsuba as mi

        origin = mi.Point3f([float(v) for v in self.pose.camera.origin])
        towards = self.pose.directions(film, self.height, self.width)
        rays = (mi.RayDifferential3f(origin, mi.Vector3f(d.tolist())) for d in towards)
        return list(np.array([look(ray) for ray in rays]).T)

    def mesh(self, hit: Any) -> Any:
        """The place in `scene.meshes` of what a preliminary intersection has hit."""
        return self._places[hit.shape.id()] if hit.is_valid() else 0

    @cached_property
    def _places(self) -> dict[str, int]:
        return {m.name: i for i, m in enumerate(self.scene.meshes)}

    def _look(self) -> None:
        self._sensor = load.sensor(self.pose.camera, self.height, self.width)

    def _launch(self, first: int, count: int, stream: str) -> Float[Array, "count h w 3"]:
        return np.stack([self._image(first + s, 1, stream) for s in range(count)])

    def _sum(self, first: int, count: int, stream: str) -> Float[Array, "h w 3"]:
        return self._image(first, count, stream).astype(np.float64) * count

    def _image(self, first: int, spp: int, stream: str) -> Float[Array, "h w 3"]:
        import mitsuba as mi

        low, high = sampler.key(stream, self.time, self.seed)
        seed = mi.sample_tea_32(low ^ first, high ^ spp)[0]
        image = mi.render(
            self.mitsuba, sensor=self._sensor, integrator=self.integrator, seed=seed, spp=spp
        )
        return np.array(image, np.float32).reshape(self.height, self.width, 3)
