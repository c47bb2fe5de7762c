"""Reservoirs: one sample of the lights out of a stream of many, and what it stands for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class Reservoir:
    """One sample for each lane, drawn nearly in proportion to a target.

    `weight` is W of Bitterli et al. 2020: an estimate of 1 / (the density that `place` has).
    """

    place: Any  # mi.Point2f: two random numbers, of which the lights make a sample
    weight: Any  # mi.Float: W
    M: Any  # mi.Float: M, how many samples it was drawn from

    def at(self, lane: Any, active: Any) -> Reservoir:
        """The reservoirs of other lanes; empty where not active."""
        import drjit as dr
        import mitsuba as mi

        x, y, weight, count = (
            dr.gather(mi.Float, values, lane, active)
            for values in (self.place.x, self.place.y, self.weight, self.M)
        )
        return Reservoir(mi.Point2f(x, y), weight, count)

    def arrays(self) -> tuple[Any, ...]:
        """All that it consists of."""
        return self.place.x, self.place.y, self.weight, self.M


def empty(lanes: int) -> Reservoir:
    """Reservoirs that have seen nothing, in memory."""
    import drjit as dr
    import mitsuba as mi

    zeros = [dr.opaque(mi.Float, 0, (lanes,)) for _ in range(4)]
    return Reservoir(mi.Point2f(zeros[0], zeros[1]), zeros[2], zeros[3])


@dataclass
class Stream:
    """Weighted reservoir sampling (Chao 1982): keeps one of all that it is shown."""

    place: Any  # mi.Point2f of the one that is kept
    target: Any  # its target, here
    source: Any  # mi.UInt32: which of the contributors it came from
    total: Any  # sum of all weights
    count: Any  # M of all that were shown

    @classmethod
    def nothing(cls) -> Stream:
        """Before anything is shown."""
        import mitsuba as mi

        return cls(mi.Point2f(0), mi.Float(0), mi.UInt32(0), mi.Float(0), mi.Float(0))

    def show(self, place: Any, target: Any, weight: Any, count: Any, source: Any, u: Any) -> Stream:
        """After one more: `weight` decides how likely it is kept, by the random number `u`."""
        import drjit as dr
        import mitsuba as mi

        total = self.total + weight
        kept = (weight > 0) & (u * total < weight)
        return Stream(
            mi.Point2f(dr.select(kept, place, self.place)),
            dr.select(kept, target, self.target),
            dr.select(kept, mi.UInt32(source), self.source),
            total,
            self.count + count,
        )

    def reservoir(self, share: Any) -> Reservoir:
        """What is kept, with W = share x total / target; `share` is 1 / M if biased (eq. 6)."""
        import drjit as dr

        weight = dr.select(self.target > 0, self.total * share / self.target, 0)
        return Reservoir(self.place, dr.select(dr.isfinite(weight), weight, 0), self.count)
