"""ReSTIR DI: candidates, reuse of the last frame, reuse of neighbours, one shadow ray, a path.

Bitterli et al. 2020, Spatiotemporal reservoir resampling for real-time ray tracing with dynamic
direct lighting. From the paper: weighted reservoir sampling of M = 32 candidates towards the
luminance of the unshadowed contribution (algorithm 3), visibility reuse, the last frame's reservoir
at the motion vector's pixel, its M at most 20 times the present one, then neighbours in a disk of
30 pixels: 5 in each of two passes and 1 / M (biased), or 3 in one pass with weights by multiple
importance sampling (unbiased).

Ours, where the paper is silent or Mitsuba differs:
- Candidates come from Mitsuba's emitter sampling: emitters by their `sampling_weight` (uniform
  where the scene gives none) rather than by power; uniform on a mesh, by brightness on a textured
  one and on an environment. Samples are kept as random numbers, see `surface`.
- Every chain has its own camera rays, jittered in the pixel, and its own reservoirs: S chains make
  S samples per pixel.
- Geometry is alike where normals differ by less than 25 degrees, and distances by less than a
  tenth; the last frame's distance is compared as it was then. Both must have the same BSDF:
  without that, 1 / M let a bright lobe's weights grow from frame to frame without bound.
- Light that arrives from other surfaces, as well as what mirrors and glass show, is the path
  tracer's own: a continuation by the BSDF, from which light that meets a lamp at once is taken off
  where the lobe was not a mirror, for that is what the reservoirs give. So a pixel that shows only
  mirror or glass gets the path tracer's full sample.
- Unbiased: the last frame's surfaces are those that its camera rays hit in the present scene, so
  it is so exactly only where no object moves; and visibility is part of the weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from baselines.restir.indirect import indirect
from baselines.restir.reservoir import Reservoir, Stream, empty
from baselines.restir.reuse import Others, merge
from baselines.restir.surface import Surface
from rlbench.pools import RenderContext

ROOM = 2**16  # chains at most: random numbers of the passes of one chain lie so far apart
DEPTH = 0.1  # relative difference of distances up to which surfaces are alike
NORMAL = math.cos(math.radians(25))


@dataclass(frozen=True)
class Config:
    """What is reused, and how. The default is the paper's biased one."""

    candidates: int = 32  # M
    visibility: bool = True  # is a candidate that is in shadow dropped?
    temporal: bool = True
    history: float = 20.0  # most M of the past, times the present one
    neighbours: int = 5
    passes: int = 2
    radius: float = 30.0  # pixels
    unbiased: bool = False


BIASED = Config()
UNBIASED = Config(neighbours=3, passes=1, unbiased=True)
PLAIN = Config(candidates=1, visibility=False, temporal=False, passes=0)


@dataclass
class Past:
    """What is remembered of the last frame, lane by lane."""

    kept: Reservoir
    normal: Any  # mi.Normal3f, towards the camera
    length: Any  # mi.Float: from the camera to the surface
    material: Any  # mi.UInt32: which BSDF it has
    ray: tuple[Any, ...]  # origin and direction, where the unbiased form asks for them


@dataclass
class Restir:
    """Chains of reservoirs on a stage, frame after frame. Lanes: pixel by pixel, chains within."""

    stage: RenderContext
    numbers: range  # of the chains: which random numbers they have
    config: Config = BIASED
    indirect: bool = True  # also emission, and light from other surfaces?
    past: Past | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Make what does not change from frame to frame."""
        import drjit as dr
        import mitsuba as mi

        self.chains = len(self.numbers)
        self.lanes = self.stage.height * self.stage.width * self.chains
        lane = dr.arange(mi.UInt32, self.lanes)
        self._each = dr.opaque(mi.UInt32, self.chains)
        self._first = dr.opaque(mi.UInt32, self.numbers.start)
        self._width = dr.opaque(mi.UInt32, self.stage.width)
        self._size = [dr.opaque(mi.Float, n) for n in (self.stage.width, self.stage.height)]
        self._pixel = lane // self._each
        self._chain = lane - self._pixel * self._each
        self._row = self._pixel // self._width
        self._column = self._pixel - self._row * self._width
        dr.eval(self._pixel, self._chain, self._row, self._column)
        depth = max(self.stage.max_depth - 1, 0)
        self._path = mi.load_dict({"type": "path", "max_depth": depth})

    def __call__(self) -> Float[Array, "chains h w 3"]:
        """The next frame of every chain."""
        radiance = self._frame()
        shape = (self.stage.height, self.stage.width, self.chains, 3)
        return np.moveaxis(np.stack(radiance, axis=-1).reshape(shape), 2, 0)

    def _frame(self) -> list[Array]:
        import drjit as dr

        ray, unbiased = self._ray(self._pixel, self._chain), self.config.unbiased
        hit = self.stage.scene.ray_intersect_preliminary(ray, coherent=True)
        dr.eval(hit)
        surface = Surface.of(self.stage.scene, ray, hit)
        kept = self._fresh(surface)
        if self.config.temporal:
            kept = self._remembered(surface, kept)
        past = Past(
            kept,
            surface.normal,
            surface.hit.t,
            surface.material,
            (ray.o, ray.d) if unbiased else (),
        )
        dr.eval(kept, past.normal, past.length, past.material, past.ray)
        for number in range(self.config.passes):
            surface = Surface.of(self.stage.scene, self._ray(self._pixel, self._chain), hit)
            past.kept = self._shared(surface, past, 2 + number)
            dr.eval(past.kept)
        surface = Surface.of(self.stage.scene, self._ray(self._pixel, self._chain), hit)
        radiance = self._shade(surface, past.kept)
        dr.eval(radiance)
        self.past = past
        return [radiance[c].numpy() for c in range(3)]

    def _fresh(self, surface: Surface) -> Reservoir:
        """Reservoirs of candidates of this frame alone (algorithm 3, and visibility reuse)."""
        import drjit as dr
        import mitsuba as mi

        numbers = self._numbers(0)
        numbers.next_2d()  # the place in the pixel

        def draw(index: Any, rng: Any, stream: Stream) -> tuple[Any, ...]:
            place = mi.Point2f(rng.next_float32(), rng.next_float32())
            target = surface.target(place, surface.lit)
            return index + 1, rng, stream.show(place, target, target, 1, 0, rng.next_float32())

        state = (mi.UInt32(0), numbers.rng, Stream.nothing())
        _, _, stream = dr.while_loop(state, lambda i, *_: i < self.config.candidates, draw)
        found = stream.reservoir(1 / self.config.candidates)
        if self.config.visibility:
            _, point = surface.light(found.place, found.weight > 0)
            seen = surface.sees(point, found.weight > 0)
            found.weight = dr.select(seen, found.weight, 0)
        found.M = dr.select(surface.lit, found.M, 0)
        return found

    def _remembered(self, surface: Surface, own: Reservoir) -> Reservoir:
        """With the last frame's reservoir of the same place on the same surface."""
        import drjit as dr
        import mitsuba as mi

        past = self.past or self._nothing()
        x, y = (dr.gather(mi.Float, part, self._pixel) for part in self.stage.motion())
        column = dr.floor(mi.Float(self._column) + 0.5 + x)
        row = dr.floor(mi.Float(self._row) + 0.5 + y)
        lane, inside = self._lane(column, row)

        def take(lane: Any, active: Any) -> Reservoir:
            found = past.kept.at(lane, active & self._alike(surface, past, lane, active))
            found.M = dr.minimum(found.M, self.config.history * own.M)
            return found

        def seen(lane: Any, active: Any) -> Surface:
            origin, towards = (
                mi.Vector3f([dr.gather(mi.Float, part[c], lane, active) for c in range(3)])
                for part in past.ray
            )
            ray = mi.RayDifferential3f(mi.Point3f(origin), towards)
            return Surface.of(
                self.stage.scene,
                ray,
                self.stage.scene.ray_intersect_preliminary(ray, active=active),
            )

        others = Others(1, lambda rng: (lane, inside), take, seen)
        return merge(surface, own, others, lambda: self._numbers(1).rng, self.config.unbiased)

    def _shared(self, surface: Surface, now: Past, number: int) -> Reservoir:
        """With reservoirs of neighbours in the same frame; `number` tells passes apart."""
        import drjit as dr
        import mitsuba as mi

        def meet(rng: Any) -> tuple[Any, Any]:
            away = self.config.radius * dr.sqrt(rng.next_float32())
            sine, cosine = dr.sincos(2 * dr.pi * rng.next_float32())
            column = dr.floor(mi.Float(self._column) + 0.5 + away * cosine)
            row = dr.floor(mi.Float(self._row) + 0.5 + away * sine)
            return self._lane(column, row)

        def take(lane: Any, active: Any) -> Reservoir:
            if not self.config.unbiased:
                active &= self._alike(surface, now, lane, active)
            return now.kept.at(lane, active)

        def seen(lane: Any, active: Any) -> Surface:
            pixel = lane // self._each
            ray = self._ray(pixel, lane - pixel * self._each)
            return Surface.of(
                self.stage.scene,
                ray,
                self.stage.scene.ray_intersect_preliminary(ray, active=active),
            )

        others = Others(self.config.neighbours, meet, take, seen)
        return merge(
            surface, now.kept, others, lambda: self._numbers(number).rng, self.config.unbiased
        )

    def _shade(self, surface: Surface, kept: Reservoir) -> Any:
        """Direct light from reservoirs, with a shadow ray, and what else a path tracer finds."""
        import drjit as dr
        import mitsuba as mi

        value, point = surface.light(kept.place, kept.weight > 0)
        seen = surface.sees(point, kept.weight > 0)
        direct = dr.select(seen, value * kept.weight, mi.Color3f(0))
        if not self.indirect:
            return direct
        emitted = surface.hit.emitter(surface.scene).eval(surface.hit)
        onward = indirect(surface, self._path, self._numbers(7)) if self.stage.max_depth > 1 else 0
        return direct + emitted + onward

    def _numbers(self, number: int) -> Any:
        return self.stage.sampler(self._pixel, self._first + self._chain + ROOM * number)

    def _ray(self, pixel: Any, chain: Any) -> Any:
        """Through the place in each pixel that a chain has chosen for this frame."""
        import mitsuba as mi

        jitter = self.stage.sampler(pixel, self._first + chain).next_2d()
        row = pixel // self._width
        column = pixel - row * self._width
        return self.stage.camera_rays(mi.Float(column) + jitter.x, mi.Float(row) + jitter.y)

    def _lane(self, column: Any, row: Any) -> tuple[Any, Any]:
        """The lane of the same chain at another pixel, and whether it is in the image."""
        import drjit as dr
        import mitsuba as mi

        width, height = self._size
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        pixel = mi.UInt32(dr.select(inside, row, 0)) * self._width
        pixel += mi.UInt32(dr.select(inside, column, 0))
        return pixel * self._each + self._chain, inside

    def _alike(self, surface: Surface, past: Past, lane: Any, active: Any) -> Any:
        """Is the surface of another lane about as far away, and does it lie alike?"""
        import drjit as dr
        import mitsuba as mi

        normal = mi.Normal3f([dr.gather(mi.Float, past.normal[c], lane, active) for c in range(3)])
        length = dr.gather(mi.Float, past.length, lane, active)
        near = dr.abs(length - surface.hit.t) < DEPTH * surface.hit.t
        same = dr.gather(mi.UInt32, past.material, lane, active) == surface.material
        return same & near & (dr.dot(normal, surface.normal) > NORMAL)

    def _nothing(self) -> Past:
        import drjit as dr
        import mitsuba as mi

        rooms = [dr.opaque(mi.Float, 0, (self.lanes,)) for _ in range(10)]
        ray = (mi.Point3f(rooms[4:7]), mi.Vector3f(rooms[7:10])) if self.config.unbiased else ()
        material = dr.opaque(mi.UInt32, 0, (self.lanes,))
        return Past(empty(self.lanes), mi.Normal3f(rooms[:3]), rooms[3], material, ray)


def biased(stage: RenderContext, numbers: range) -> Restir:
    """The paper's biased configuration: what a clip's `restir` pool holds."""
    return Restir(stage, numbers)


def unbiased(stage: RenderContext, numbers: range) -> Restir:
    """The unbiased configuration: right in the mean, noisier, and several times as dear."""
    return Restir(stage, numbers, UNBIASED)
