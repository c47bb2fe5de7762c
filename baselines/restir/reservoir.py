"""Reservoirs, and streaming weighted reservoir sampling of light samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = ["Reservoir", "ReservoirStream", "empty_reservoirs"]


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
