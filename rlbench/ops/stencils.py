"""Filter stencils as lists of taps: one tap of each opposite pair, since both weigh the same."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Tap", "atrous_taps", "box_taps"]

B3_SPLINE = (3 / 8, 1 / 4, 1 / 16)  # weight by distance from the centre, in steps


class Tap(NamedTuple):
    """A neighbour below or to the right; its opposite neighbour has the same weight."""

    down: int  # pixels
    right: int  # pixels
    weight: float  # relative to a centre weight of 1


def box_taps(reach: int) -> list[Tap]:
    """Taps of a box filter of (2 reach + 1)^2 pixels, each of weight 1 like the centre.

    >>> len(box_taps(1))  # of 8 neighbours
    4
    """
    return [Tap(*offset, 1.0) for offset in _half_plane(reach)]


def atrous_taps(step: int) -> list[Tap]:
    """Taps of the 5 x 5 B3 spline, `step` pixels apart, relative to a centre weight of 1.

    The kernel of the à-trous wavelet transform (Dammertz et al. 2010; Schied et al. 2017): pass i
    uses step 2^i.

    >>> atrous_taps(4)[0]
    Tap(down=0, right=4, weight=0.6666666666666666)
    """
    kernel = [weight / B3_SPLINE[0] for weight in B3_SPLINE]
    return [Tap(y * step, x * step, kernel[y] * kernel[abs(x)]) for y, x in _half_plane(2)]


def _half_plane(reach: int) -> list[tuple[int, int]]:
    """Offsets (down, right) after the centre in reading order, up to `reach` away."""
    square = [(y, x) for y in range(reach + 1) for x in range(-reach, reach + 1)]
    return [offset for offset in square if offset > (0, 0)]
