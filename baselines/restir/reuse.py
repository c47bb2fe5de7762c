"""Combine reservoirs, biased or unbiased; temporal and spatial reuse differ in their source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from baselines.restir.reservoir import Reservoir, ReservoirStream
from baselines.restir.surface import Surface, finite_luminance

__all__ = ["ReuseSource", "combine_reservoirs"]

ChooseLane = Callable[[Any], tuple[Any, Any]]  # random numbers to a lane, and whether it exists


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
