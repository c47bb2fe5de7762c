"""One frame of ReSTIR DI: initial candidates, visibility, temporal and spatial reuse, shading.

Bitterli et al. 2020, Spatiotemporal reservoir resampling for real-time ray tracing with dynamic
direct lighting. From the paper: weighted reservoir sampling of M = 32 candidates with the luminance
of the unshadowed contribution as target (algorithm 3); visibility reuse; temporal reuse of the
previous frame's reservoir at the motion vector's pixel, with an M-cap of 20 times the current M;
spatial reuse in a disk of 30 pixels: 5 neighbours in each of two passes and 1 / M (biased), or 3
neighbours in one pass with multiple importance sampling weights (unbiased).

Ours, where the paper is silent or Mitsuba differs:
- Candidates come from Mitsuba's emitter sampling: emitters by their `sampling_weight` (uniform
  unless the scene sets it), not by power; uniform on a mesh, by brightness on a textured emitter
  and on an environment. Samples are stored as random numbers, see `surface`.
- Every chain has its own camera rays, jittered within the pixel, and its own reservoirs: S chains
  make S samples per pixel.
- Reservoirs are reused where normals differ by less than 25 degrees and distances by less than a
  tenth; the previous frame's distance is compared as it was then. The BSDFs must be equal as well:
  otherwise, with 1 / M, the weights of a bright lobe grew from frame to frame without bound.
- Indirect light, and what mirrors and glass show, is path traced: a continuation by the BSDF, from
  which direct emission at the next hit is subtracted unless the lobe was a mirror, because the
  reservoirs provide it. A pixel that shows only mirror or glass gets the path tracer's full sample.
- Unbiased: the previous frame's surfaces are those that its camera rays hit in the current scene,
  so it is exactly unbiased only where no object moves. The weights include visibility.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from baselines.restir.reservoir import (
    History,
    Reservoir,
    ReservoirStream,
    ReuseSource,
    combine_reservoirs,
)
from baselines.restir.surface import Surface, trace_indirect
from rlbench.pools import RenderContext

# purposes of random numbers; spatial passes follow from SPATIAL on
INITIAL, TEMPORAL, SPATIAL, INDIRECT = 0, 1, 2, 7
MAX_CHAINS = 2**16  # distance between the random number streams of a chain's passes


@dataclass(frozen=True)
class Config:
    """Parameters of reuse. The default is the paper's biased configuration."""

    candidates: int = 32  # initial M
    visibility_reuse: bool = True  # occluded candidates are dropped
    temporal_reuse: bool = True
    m_cap: float = 20.0  # largest M of the history, times the current M
    neighbours: int = 5  # of each spatial pass
    passes: int = 2  # of spatial reuse
    radius: float = 30.0  # of spatial reuse, pixels
    unbiased: bool = False


BIASED = Config()
UNBIASED = Config(neighbours=3, passes=1, unbiased=True)
PLAIN = Config(candidates=1, visibility_reuse=False, temporal_reuse=False, passes=0)


@dataclass
class Lanes:
    """Pixels and chains of all lanes, their camera rays and their random numbers."""

    context: RenderContext
    chain_indices: range  # of the chains; they select the random numbers

    def __post_init__(self) -> None:
        """Compute what does not change from frame to frame."""
        import drjit as dr
        import mitsuba as mi

        self.chains = len(self.chain_indices)
        self.count = self.context.height * self.context.width * self.chains
        lane = dr.arange(mi.UInt32, self.count)
        # opaque: other sizes and chains reuse the compiled kernels
        self._chains = dr.opaque(mi.UInt32, self.chains)
        self._first_chain = dr.opaque(mi.UInt32, self.chain_indices.start)
        self._width = dr.opaque(mi.UInt32, self.context.width)
        self._size = [dr.opaque(mi.Float, n) for n in (self.context.width, self.context.height)]
        self._pixel = lane // self._chains
        self._chain = lane - self._pixel * self._chains
        self._row = self._pixel // self._width
        self._column = self._pixel - self._row * self._width
        dr.eval(self._pixel, self._chain, self._row, self._column)

    def camera_rays(self) -> Any:
        """Camera rays of all lanes, jittered within the pixel for each chain and frame."""
        return self._camera_rays(self._pixel, self._chain)

    def camera_rays_of(self, lane: Any) -> Any:
        """Camera rays of other lanes."""
        pixel = lane // self._chains
        return self._camera_rays(pixel, lane - pixel * self._chains)

    def random_numbers(self, purpose: int) -> Any:
        """A sampler for all lanes, independent for each `purpose`; 0 begins with the jitter."""
        return self.context.sampler(
            self._pixel, self._first_chain + self._chain + MAX_CHAINS * purpose
        )

    def previous(self) -> tuple[Any, Any]:
        """The lane at each pixel's position in the previous frame, and whether it exists."""
        import drjit as dr
        import mitsuba as mi

        x, y = (dr.gather(mi.Float, part, self._pixel) for part in self.context.motion())
        return self.at_offset(x, y)

    def at_offset(self, x: Any, y: Any) -> tuple[Any, Any]:
        """The lane of the same chain x pixels right and y down, and whether it exists."""
        import drjit as dr
        import mitsuba as mi

        column = dr.floor(mi.Float(self._column) + 0.5 + x)
        row = dr.floor(mi.Float(self._row) + 0.5 + y)
        width, height = self._size
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        pixel = mi.UInt32(dr.select(inside, row, 0)) * self._width
        pixel += mi.UInt32(dr.select(inside, column, 0))
        return pixel * self._chains + self._chain, inside

    def _camera_rays(self, pixel: Any, chain: Any) -> Any:
        import mitsuba as mi

        jitter = self.context.sampler(pixel, self._first_chain + chain).next_2d()
        row = pixel // self._width
        column = pixel - row * self._width
        return self.context.camera_rays(mi.Float(column) + jitter.x, mi.Float(row) + jitter.y)


@dataclass
class Restir:
    """Chains of reservoirs that advance frame by frame; call it once per frame, in order."""

    context: RenderContext
    chain_indices: range  # of the chains; they select the random numbers
    config: Config = BIASED
    indirect: bool = True  # adds emission and indirect light
    history: History | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Compute what does not change from frame to frame."""
        import mitsuba as mi

        self._lanes = Lanes(self.context, self.chain_indices)
        max_depth = max(self.context.max_depth - 1, 0)
        self._path = mi.load_dict({"type": "path", "max_depth": max_depth})

    def __call__(self) -> Float[Array, "chains h w 3"]:
        """The next frame of every chain, linear radiance."""
        radiance = self._render()
        shape = (self.context.height, self.context.width, self._lanes.chains, 3)
        channels = [radiance[c].numpy() for c in range(3)]
        return np.moveaxis(np.stack(channels, axis=-1).reshape(shape), 2, 0)

    def _render(self) -> Any:
        """Radiance of all lanes (mi.Color3f), evaluated; updates the history."""
        import drjit as dr

        ray, unbiased = self._lanes.camera_rays(), self.config.unbiased
        intersection = self.context.scene.ray_intersect_preliminary(ray, coherent=True)
        dr.eval(intersection)
        surface = Surface.from_intersection(self.context.scene, ray, intersection)

        # initial candidates, visibility reuse, temporal reuse
        reservoir = self._initial_candidates(surface)
        if self.config.visibility_reuse:
            reservoir = self._visibility_reuse(surface, reservoir)
        reservoir.M = dr.select(surface.has_non_delta_lobe, reservoir.M, 0)
        if self.config.temporal_reuse:
            reservoir = self._temporal_reuse(surface, reservoir)
        current = History.from_frame(reservoir, surface, with_rays=unbiased)

        # spatial reuse
        for index in range(self.config.passes):
            surface = self._surface(intersection)
            current.reservoir = self._spatial_reuse(surface, current, SPATIAL + index)
            dr.eval(current.reservoir)

        # shading
        radiance = self._shade(self._surface(intersection), current.reservoir)
        dr.eval(radiance)
        self.history = current
        return radiance

    def _surface(self, intersection: Any) -> Surface:
        """The first surfaces again, in a new kernel."""
        return Surface.from_intersection(
            self.context.scene, self._lanes.camera_rays(), intersection
        )

    def _initial_candidates(self, surface: Surface) -> Reservoir:
        """Reservoirs of this frame's candidates alone (algorithm 3)."""
        import drjit as dr
        import mitsuba as mi

        numbers = self._lanes.random_numbers(INITIAL)
        numbers.next_2d()  # the jitter within the pixel

        def draw(index: Any, rng: Any, stream: ReservoirStream) -> tuple[Any, ...]:
            sample = mi.Point2f(rng.next_float32(), rng.next_float32())
            target = surface.target(sample, surface.has_non_delta_lobe)
            return index + 1, rng, stream.update(sample, target, target, 1, 0, rng.next_float32())

        state = (mi.UInt32(0), numbers.rng, ReservoirStream.empty())
        _, _, stream = dr.while_loop(state, lambda i, *_: i < self.config.candidates, draw)
        return stream.to_reservoir(1 / self.config.candidates)

    def _visibility_reuse(self, surface: Surface, own: Reservoir) -> Reservoir:
        """The reservoirs with W = 0 where the sample is occluded."""
        import drjit as dr

        _, point = surface.direct_light(own.sample, own.weight > 0)
        visible = surface.is_visible(point, own.weight > 0)
        return Reservoir(own.sample, dr.select(visible, own.weight, 0), own.M)

    def _temporal_reuse(self, surface: Surface, own: Reservoir) -> Reservoir:
        """Combined with the previous frame's reservoir of the same surface point."""
        import drjit as dr

        unbiased = self.config.unbiased
        past = self.history or History.empty(self._lanes.count, with_rays=unbiased)
        lane, inside = self._lanes.previous()

        def read_reservoir(lane: Any, active: Any) -> Reservoir:
            reservoir = past.reservoir.gather(
                lane, active & past.is_same_surface(surface, lane, active)
            )
            reservoir.M = dr.minimum(reservoir.M, self.config.m_cap * own.M)
            return reservoir

        def read_surface(lane: Any, active: Any) -> Surface:
            return self._intersect(past.rays_of(lane, active), active)

        source = ReuseSource(1, lambda rng: (lane, inside), read_reservoir, read_surface)
        return combine_reservoirs(surface, own, source, self._make_rng(TEMPORAL), unbiased)

    def _spatial_reuse(self, surface: Surface, current: History, purpose: int) -> Reservoir:
        """Combined with reservoirs of random neighbours in the same frame."""
        import drjit as dr

        def choose_neighbour(rng: Any) -> tuple[Any, Any]:
            distance = self.config.radius * dr.sqrt(rng.next_float32())
            sine, cosine = dr.sincos(2 * dr.pi * rng.next_float32())
            return self._lanes.at_offset(distance * cosine, distance * sine)

        def read_reservoir(lane: Any, active: Any) -> Reservoir:
            if not self.config.unbiased:
                active &= current.is_same_surface(surface, lane, active)
            return current.reservoir.gather(lane, active)

        def read_surface(lane: Any, active: Any) -> Surface:
            return self._intersect(self._lanes.camera_rays_of(lane), active)

        source = ReuseSource(self.config.neighbours, choose_neighbour, read_reservoir, read_surface)
        return combine_reservoirs(
            surface, current.reservoir, source, self._make_rng(purpose), self.config.unbiased
        )

    def _shade(self, surface: Surface, reservoir: Reservoir) -> Any:
        """Direct light of the reservoirs with a shadow ray, emission, and indirect light."""
        import drjit as dr
        import mitsuba as mi

        value, point = surface.direct_light(reservoir.sample, reservoir.weight > 0)
        visible = surface.is_visible(point, reservoir.weight > 0)
        direct = dr.select(visible, value * reservoir.weight, mi.Color3f(0))
        if not self.indirect:
            return direct
        emitted = surface.hit.emitter(surface.scene).eval(surface.hit)
        numbers = self._lanes.random_numbers(INDIRECT)
        indirect = trace_indirect(surface, self._path, numbers) if self.context.max_depth > 1 else 0
        return direct + emitted + indirect

    def _intersect(self, ray: Any, active: Any) -> Surface:
        intersection = self.context.scene.ray_intersect_preliminary(ray, active=active)
        return Surface.from_intersection(self.context.scene, ray, intersection)

    def _make_rng(self, purpose: int) -> Any:
        """A function that returns the same generator at every call."""
        return lambda: self._lanes.random_numbers(purpose).rng


def biased(stage: RenderContext, chain_indices: range) -> Restir:
    """The paper's biased configuration, which fills a clip's `restir` pool."""
    return Restir(stage, chain_indices)


def unbiased(stage: RenderContext, chain_indices: range) -> Restir:
    """The unbiased configuration: noisier, and several times as expensive."""
    return Restir(stage, chain_indices, UNBIASED)
