"""Fountain: a stone basin with a stem and bowl, and the kerbs of the ring road around it."""

from __future__ import annotations

from rlbench.scenes.parts.primitives import boxes, lathe
from rlbench.scenes.parts.shape import Shape, merge


def build_kerbs(road_radius: float) -> Shape:
    """Low stone kerbs on both sides of the road."""
    inner, outer = road_radius - 1.6, road_radius + 1.6
    return merge(
        lathe([(outer, 0.0), (outer, 0.1), (outer + 0.14, 0.1), (outer + 0.14, 0.0)][::-1], 96),
        lathe([(inner, 0.0), (inner, 0.1), (inner - 0.14, 0.1), (inner - 0.14, 0.0)], 96),
    )


def build_fountain() -> Shape:
    """The basin, the stem with its bowl, and the base of the golden ball."""
    rim = lathe(
        [(3.1, 0), (3.15, 0.08), (3.05, 0.14), (3.05, 0.5), (3.3, 0.58), (3.3, 0.75), (2.8, 0.75)]
        + [(2.8, 0.2)],
        64,
    )
    stem = lathe(
        [(0.8, 0.1), (0.7, 0.3), (0.35, 0.6), (0.28, 1.2), (0.45, 1.45), (1.3, 1.75), (1.4, 1.95)]
        + [(1.3, 1.95), (0.3, 1.8), (0.22, 2.2), (0.3, 2.55), (0.2, 2.7)],
        40,
    )
    return merge(rim, stem, boxes((-0.2, -0.2, 2.55), (0.2, 0.2, 2.7)))
