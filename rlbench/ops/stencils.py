"""Which neighbours a filter looks at: one of each opposite pair, for their weights are alike."""

from __future__ import annotations

from typing import NamedTuple

SPLINE = (3 / 8, 1 / 4, 1 / 16)  # B3, by distance in steps


class Tap(NamedTuple):
    """A neighbour, below or to the right; its opposite has the same weight."""

    down: int  # pixels
    right: int  # pixels
    weight: float


def box(reach: int) -> list[Tap]:
    """All neighbours within `reach` pixels, alike; the pixel itself weighs 1 too."""
    return [Tap(*place, 1.0) for place in _ahead(reach)]


def atrous_taps(step: int) -> list[Tap]:
    """The 5 x 5 B3 spline with `step` pixels from tap to tap, where the pixel itself weighs 1."""
    kernel = [weight / SPLINE[0] for weight in SPLINE]
    return [Tap(y * step, x * step, kernel[y] * kernel[abs(x)]) for y, x in _ahead(2)]


def _ahead(reach: int) -> list[tuple[int, int]]:
    square = [(y, x) for y in range(reach + 1) for x in range(-reach, reach + 1)]
    return [place for place in square if place > (0, 0)]
