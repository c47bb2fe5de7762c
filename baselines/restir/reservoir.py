"""Reservoirs of light samples: drawn as a stream, combined with others, and kept with surfaces."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from baselines.restir.surface import Surface, finite_luminance

MAX_DEPTH_DIFFERENCE = 0.1  # relative, between surfaces that share reservoirs
MIN_NORMAL_COSINE = math.cos(math.radians(25))

ChooseLane = Callable[[Any], tuple[Any, Any]]  # random numbers to a lane, and whether it exists


@dataclass
class Reservoir:
    """One light sample per lane, drawn approximately in proportion to a target function.

    `weight` is W of Bitterli et al. 2020: an estimate of 1 / (the probability density of `sample`).
    """

    sample: Any  # mi.Point2f: the light sample as two random numbers, see `surface`
    weight: Any  # mi.Float: W
    M: Any  # mi.Float: number of candidates that it was drawn from

    def gather(self, lane: Any, active: Any) -> Reservoir:
        """The reservoirs of other lanes; empty where not active."""
        import drjit as dr
        import mitsuba as mi

        x, y, weight, count = (
            dr.gather(mi.Float, values, lane, active)
            for values in (self.sample.x, self.sample.y, self.weight, self.M)
        )
        return Reservoir(mi.Point2f(x, y), weight, count)


def empty_reservoirs(lanes: int) -> Reservoir:
    """Evaluated reservoirs without candidates, M = 0."""
    import drjit as dr
    import mitsuba as mi

    zeros = [dr.opaque(mi.Float, 0, (lanes,)) for _ in range(4)]
    return Reservoir(mi.Point2f(zeros[0], zeros[1]), zeros[2], zeros[3])


@dataclass
class ReservoirStream:
    """Weighted reservoir sampling (Chao 1982): selects one sample of a stream."""

    sample: Any  # mi.Point2f: the selected sample
    target: Any  # its target function at this pixel
    source: Any  # mi.UInt32: index of the reservoir that it came from; 0 is the pixel's own
    weight_sum: Any  # of all samples so far
    M: Any  # of all samples so far

    @classmethod
    def empty(cls) -> ReservoirStream:
        """A stream without samples."""
        import mitsuba as mi

        return cls(mi.Point2f(0), mi.Float(0), mi.UInt32(0), mi.Float(0), mi.Float(0))

    def update(
        self, sample: Any, target: Any, weight: Any, count: Any, source: Any, u: Any
    ) -> ReservoirStream:
        """The stream after one more sample of M = `count`.

        The sample is selected with probability weight / weight_sum; `u` is a random number.
        """
        import drjit as dr
        import mitsuba as mi

        weight_sum = self.weight_sum + weight
        is_selected = (weight > 0) & (u * weight_sum < weight)
        return ReservoirStream(
            mi.Point2f(dr.select(is_selected, sample, self.sample)),
            dr.select(is_selected, target, self.target),
            dr.select(is_selected, mi.UInt32(source), self.source),
            weight_sum,
            self.M + count,
        )

    def to_reservoir(self, normalisation: Any) -> Reservoir:
        """The selected sample with W = normalisation * weight_sum / target (eq. 6).

        `normalisation` is 1 / M for biased reuse.
        """
        import drjit as dr

        weight = dr.select(self.target > 0, self.weight_sum * normalisation / self.target, 0)
        return Reservoir(self.sample, dr.select(dr.isfinite(weight), weight, 0), self.M)


@dataclass
class History:
    """Reservoirs with their surfaces, one per lane."""

    reservoir: Reservoir
    normal: Any  # mi.Normal3f, towards the camera
    distance: Any  # mi.Float: from the camera to the surface
    bsdf_index: Any  # mi.UInt32
    ray: tuple[Any, ...]  # origin and direction, for unbiased reuse only

    @classmethod
    def from_frame(cls, reservoir: Reservoir, surface: Surface, with_rays: bool) -> History:
        """The reservoirs of a frame with their surfaces, evaluated."""
        import drjit as dr

        ray = (surface.ray.o, surface.ray.d) if with_rays else ()
        history = cls(reservoir, surface.normal, surface.hit.t, surface.bsdf_index, ray)
        dr.eval(reservoir, history.normal, history.distance, history.bsdf_index, history.ray)
        return history

    @classmethod
    def empty(cls, lanes: int, with_rays: bool) -> History:
        """No reservoirs: the history before the first frame."""
        import drjit as dr
        import mitsuba as mi

        zeros = [dr.opaque(mi.Float, 0, (lanes,)) for _ in range(10)]
        ray = (mi.Point3f(zeros[4:7]), mi.Vector3f(zeros[7:10])) if with_rays else ()
        bsdf_index = dr.opaque(mi.UInt32, 0, (lanes,))
        return cls(empty_reservoirs(lanes), mi.Normal3f(zeros[:3]), zeros[3], bsdf_index, ray)

    def is_same_surface(self, surface: Surface, lane: Any, active: Any) -> Any:
        """Whether distance, normal and BSDF at `lane` agree with those of `surface`."""
        import drjit as dr
        import mitsuba as mi

        normal = mi.Normal3f([dr.gather(mi.Float, self.normal[c], lane, active) for c in range(3)])
        distance = dr.gather(mi.Float, self.distance, lane, active)
        near = dr.abs(distance - surface.hit.t) < MAX_DEPTH_DIFFERENCE * surface.hit.t
        same_bsdf = dr.gather(mi.UInt32, self.bsdf_index, lane, active) == surface.bsdf_index
        return same_bsdf & near & (dr.dot(normal, surface.normal) > MIN_NORMAL_COSINE)

    def rays_of(self, lane: Any, active: Any) -> Any:
        """The stored camera rays of other lanes."""
        import drjit as dr
        import mitsuba as mi

        origin, direction = (
            mi.Vector3f([dr.gather(mi.Float, part[c], lane, active) for c in range(3)])
            for part in self.ray
        )
        return mi.RayDifferential3f(mi.Point3f(origin), direction)


@dataclass(frozen=True)
class ReuseSource:
    """The reservoirs to reuse: those of neighbours or of the previous frame."""

    count: int  # reservoirs per lane
    choose_lane: ChooseLane
    read_reservoir: Callable[[Any, Any], Reservoir]  # of lanes, where active
    read_surface: Callable[[Any, Any], Surface]  # of lanes, where active; unbiased reuse only


def combine_reservoirs(
    surface: Surface,
    own: Reservoir,
    source: ReuseSource,
    make_rng: Callable[[], Any],
    unbiased: bool,
) -> Reservoir:
    """One reservoir from a pixel's own and others (Bitterli et al. 2020, algorithms 4 and 6).

    The weight of a sample is its target at this pixel times its W and M. `make_rng` returns the
    same random number generator at every call.
    """
    import drjit as dr
    import mitsuba as mi

    own_target = surface.target(own.sample, own.weight > 0)
    start = ReservoirStream.empty().update(
        own.sample, own_target, own_target * own.weight * own.M, own.M, 0, 0.0
    )

    def update(index: Any, rng: Any, stream: ReservoirStream) -> tuple[Any, ...]:
        lane, active = source.choose_lane(rng)
        other = source.read_reservoir(lane, active & surface.has_non_delta_lobe)
        target = surface.target(other.sample, other.weight > 0)
        weight = target * other.weight * other.M
        u = rng.next_float32()
        return index + 1, rng, stream.update(other.sample, target, weight, other.M, index + 1, u)

    state = (mi.UInt32(0), make_rng(), start)
    _, _, stream = dr.while_loop(state, lambda i, *_: i < source.count, update)
    if not unbiased:
        return stream.to_reservoir(1 / dr.maximum(stream.M, 1))
    return stream.to_reservoir(_mis_normalisation(surface, own, source, make_rng, stream))


def _mis_normalisation(
    surface: Surface,
    own: Reservoir,
    source: ReuseSource,
    make_rng: Callable[[], Any],
    stream: ReservoirStream,
) -> Any:
    """Unbiased replacement of 1 / M: p_s / (sum of M_i p_i) for the selected sample.

    p_i is the sample's target with visibility at contributor i, and s is the contributor that the
    sample came from.
    """
    import drjit as dr
    import mitsuba as mi

    is_selected = stream.target > 0
    own_target = visible_target(surface, stream.sample, is_selected)
    state = (
        mi.UInt32(0),
        make_rng(),
        own.M * own_target,
        dr.select(stream.source == 0, own_target, 0),
    )

    def add_target(index: Any, rng: Any, total: Any, source_target: Any) -> tuple[Any, ...]:
        lane, active = source.choose_lane(rng)
        rng.next_float32()  # `combine_reservoirs` drew one here
        active &= is_selected & surface.has_non_delta_lobe
        count = source.read_reservoir(lane, active).M
        target = visible_target(source.read_surface(lane, active), stream.sample, active)
        source_target = dr.select(stream.source == index + 1, target, source_target)
        return index + 1, rng, total + count * target, source_target

    _, _, total, source_target = dr.while_loop(state, lambda i, *_: i < source.count, add_target)
    return dr.select(total > 0, source_target / total, 0)


def visible_target(surface: Surface, sample: Any, active: Any) -> Any:
    """The target of a light sample with visibility: 0 where it is occluded."""
    import drjit as dr

    value, point = surface.direct_light(sample, active)
    target = finite_luminance(value)
    return dr.select(surface.is_visible(point, active & (target > 0)), target, 0)
