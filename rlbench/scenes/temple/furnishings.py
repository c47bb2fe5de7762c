"""Furnishings of the temple: pots, plants, banners, a swinging lamp and turning rings."""

from __future__ import annotations

import numpy as np

from rlbench.scenes.parts.primitives import boxes, cylinder, icosphere, lathe
from rlbench.scenes.parts.shape import Shape, merge, rotation_matrix, transform, yaw_matrix
from rlbench.scenes.parts.sheets import leaf_blade, sheet, torus
from rlbench.scenes.temple.stone import HEIGHT

LAMP_PIVOT = np.array([-1.9, 6.5, HEIGHT])  # the lamp hangs from it
RING_CENTRE = np.array([0.0, 12.5, 2.4])  # centre of the turning rings
POTS = ((2.25, 6.0), (-2.2, 8.4), (2.2, 17.2), (-2.2, 19.0), (-2.3, 3.4))
BANNERS = (
    (-1.9, 9.0),
    (1.9, 9.0),
    (-1.9, 17.0),
    (1.9, 17.0),
)  # they hang from beams and face the door


def build_pots() -> Shape:
    """Glazed pots in the nave."""
    belly = [(0.24, 0.0), (0.27, 0.04), (0.36, 0.22), (0.44, 0.45), (0.43, 0.62), (0.33, 0.76)]
    pot = lathe([*belly, (0.31, 0.82), (0.38, 0.88), (0.37, 0.92), (0.31, 0.9), (0.27, 0.7)], 40)
    return merge(*(transform(pot, (x, y, 0.0)) for x, y in POTS))


def build_plants(random: np.random.Generator) -> Shape:
    """A tuft of long leaves in each pot."""
    leaf = leaf_blade(1.15, 0.15, 1.35, 1.5, steps=10, cup=0.5)
    parts = []
    for x, y in POTS:
        for number in range(26):
            turn = yaw_matrix(2.4 * number) @ rotation_matrix(
                (0, 1, 0), random.uniform(-0.15, 0.55)
            )
            parts.append(transform(leaf, (x, y, 0.72), turn, random.uniform(0.65, 1.1)))
    return merge(*parts)


def build_pedestal_and_altar() -> Shape:
    """The round pedestal below the rings, and the altar."""
    low = [(0.95, 0.0), (0.95, 0.16), (0.75, 0.18), (0.75, 0.34), (0.5, 0.37), (0.4, 0.44)]
    foot = lathe([*low, (0.3, 0.7), (0.28, 0.95), (0.36, 1.1), (0.4, 1.15), (0.01, 1.17)], 64)
    altar = boxes([(-0.9, 29.0, 0.6), (-1.0, 28.9, 1.4)], [(0.9, 29.9, 1.4), (1.0, 30.0, 1.6)])
    return merge(transform(foot, (RING_CENTRE[0], RING_CENTRE[1], 0)), altar)


def build_banners(time: float) -> Shape:
    """Banners at a time; they hang from beams and sway most at their lower ends."""
    across, down = np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(1, 0, 21))
    parts = []
    for number, (x, y) in enumerate(BANNERS):
        phase = 2 * np.pi * time / (31 + 3 * number) + 1.9 * number
        wave = 0.22 * down * np.sin(phase - 2.6 * down) + 0.05 * np.sin(
            5.5 * across + 2.1 * phase - 3 * down
        ) * (0.25 + down)
        tip = 2.5 * down - 0.3 * down**4 * np.abs(2 * across)
        at = np.stack([x + 1.05 * across, y + wave, HEIGHT - 0.75 - tip], -1)
        flag = sheet(at)
        uv = np.stack([across + 0.5, 1 - down], -1).reshape(-1, 2).astype(np.float32)
        parts.append(flag._replace(uv=uv))
    return merge(*parts)


def build_lamp_and_rings(time: float) -> Shape:
    """The swinging lamp, and three nested rings that turn, at a time."""
    swing = rotation_matrix((0.25, 1, 0), 0.2 * np.sin(2 * np.pi * time / 70 + 0.4))
    lamp = [cylinder(0.02, -4.6, 0.0, 8), transform(icosphere(2), (0, 0, -4.75), scale=0.14)]
    lamp += [transform(torus(0.42, 0.035, 40), (0, 0, -5.35))]
    lamp += [
        transform(torus(0.42, 0.03, 32, 8), (0, 0, -5.0), rotation_matrix((0, 1, 0), np.pi / 2))
    ]
    lamp += [
        transform(torus(0.42, 0.03, 32, 8), (0, 0, -5.0), rotation_matrix((1, 0, 0), np.pi / 2))
    ]
    rings = []
    for radius, tilt, period in ((1.15, 1.45, 150.0), (0.98, 0.9, -95.0), (0.82, 0.4, 60.0)):
        turn = yaw_matrix(2 * np.pi * time / period + radius * 7) @ rotation_matrix((1, 0, 0), tilt)
        rim = [(radius, -0.09), (radius + 0.06, -0.09), (radius + 0.06, 0.09), (radius, 0.09)]
        rings.append(transform(lathe([*rim, rim[0]], 56), RING_CENTRE, turn))
    return merge(transform(merge(*lamp), LAMP_PIVOT, swing), *rings)


def build_glass_ball(time: float) -> Shape:
    """The glass ball that drifts within the rings, at a time."""
    angle = 2 * np.pi * time / 60
    return transform(
        icosphere(4), RING_CENTRE + (0.1 * np.cos(angle), 0, 0.1 * np.sin(angle)), scale=0.5
    )
