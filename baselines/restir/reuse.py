"""Taking over what other reservoirs hold: those of the last frame, or those of neighbours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from baselines.restir.reservoir import Reservoir, Stream
from baselines.restir.surface import Surface, brightness

Meet = Callable[[Any], tuple[Any, Any]]  # random numbers to a lane, and whether there is one


@dataclass(frozen=True)
class Others:
    """Reservoirs to take over, a few for each lane."""

    number: int
    meet: Meet
    take: Callable[[Any, Any], Reservoir]  # of lanes, where active
    surface: Callable[[Any, Any], Surface]  # theirs; asked for by the unbiased form alone


def merge(
    surface: Surface, own: Reservoir, others: Others, rng: Callable[[], Any], unbiased: bool
) -> Reservoir:
    """One reservoir out of one's own and others' (Bitterli et al. 2020, algorithms 4 and 6).

    A sample's weight is its target here, times its W and M. `rng` gives the same generator of
    random numbers at every call.
    """
    import drjit as dr
    import mitsuba as mi

    here = surface.target(own.place, own.weight > 0)
    start = Stream.nothing().show(own.place, here, here * own.weight * own.M, own.M, 0, 0.0)

    def look(index: Any, numbers: Any, stream: Stream) -> tuple[Any, ...]:
        lane, active = others.meet(numbers)
        other = others.take(lane, active & surface.lit)
        target = surface.target(other.place, other.weight > 0)
        weight = target * other.weight * other.M
        u = numbers.next_float32()
        return (
            index + 1,
            numbers,
            stream.show(other.place, target, weight, other.M, index + 1, u),
        )

    state = (mi.UInt32(0), rng(), start)
    _, _, stream = dr.while_loop(state, lambda i, *_: i < others.number, look)
    if not unbiased:
        return stream.reservoir(1 / dr.maximum(stream.count, 1))
    return stream.reservoir(_share(surface, own, others, rng, stream))


def _share(
    surface: Surface, own: Reservoir, others: Others, rng: Callable[[], Any], stream: Stream
) -> Any:
    """What replaces 1 / M: the target where the kept sample is from, over the sum of M x target.

    Targets with visibility here, of every contributor that could have given the sample.
    """
    import drjit as dr
    import mitsuba as mi

    alive = stream.target > 0
    mine = seen_target(surface, stream.place, alive)
    state = (mi.UInt32(0), rng(), own.M * mine, dr.select(stream.source == 0, mine, 0))

    def ask(index: Any, numbers: Any, total: Any, source: Any) -> tuple[Any, ...]:
        lane, active = others.meet(numbers)
        numbers.next_float32()
        active &= alive & surface.lit
        count = others.take(lane, active).M
        theirs = seen_target(others.surface(lane, active), stream.place, active)
        chosen = dr.select(stream.source == index + 1, theirs, source)
        return index + 1, numbers, total + count * theirs, chosen

    _, _, total, source = dr.while_loop(state, lambda i, *_: i < others.number, ask)
    return dr.select(total > 0, source / total, 0)


def seen_target(surface: Surface, place: Any, active: Any) -> Any:
    """The target of a sample, or 0 where it lies in shadow."""
    import drjit as dr

    value, point = surface.light(place, active)
    target = brightness(value)
    return dr.select(surface.sees(point, active & (target > 0)), target, 0)
