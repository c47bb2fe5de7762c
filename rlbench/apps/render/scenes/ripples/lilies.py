"""Lilies: pads and flowers that float on moving water, and balls that bob in it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from rlbench.apps.render.scenes.parts.shapes import (
    Float64Array,
    Shape,
    icosphere,
    merge,
    paint,
    quads,
    rotation_matrix,
    transform,
    yaw_matrix,
)

HeightField = Callable[[Float64Array, Float64Array, float], Float64Array]
FLOATING_COLOURS = (
    (0.09, 0.22, 0.05),  # 0 pads, from centre to rim
    (0.13, 0.28, 0.07),
    (0.10, 0.20, 0.05),
    (0.30, 0.10, 0.08),
    (0.80, 0.36, 0.46),  # 4 petals
    (0.86, 0.74, 0.76),
    (0.85, 0.55, 0.08),
    (0.80, 0.12, 0.05),  # 7 balls
    (0.82, 0.80, 0.74),
    (0.03, 0.10, 0.20),
)
FLOWERS = ((-1.55, -0.95, 0.2), (-0.62, -2.05, 0.16), (2.2, -1.95, 0.18))  # x, y, radius
BALLS = ((0.35, -1.2, 0.24, 7), (1.0, -1.75, 0.15, 9))  # x, y, radius, colour
PAD_LIFT = 0.008  # metres above the water, more than the error of its facets


def build_floating(height: HeightField, time: float) -> Shape:
    """Pads, flowers and balls on water of `height` (x, y, time), in FLOATING_COLOURS."""
    pads = _build_pads()
    x, y = pads.vertices[:, 0].astype(float), pads.vertices[:, 1].astype(float)
    level = height(x, y, time) + PAD_LIFT + pads.vertices[:, 2]
    lying = pads._replace(vertices=np.stack([x, y, level], -1).astype(np.float32))
    flowers = [
        transform(
            _build_flower(),
            (x, y, float(height(np.array(x), np.array(y), time)) + 0.02),
            yaw_matrix(x),
            r,
        )
        for x, y, r in FLOWERS
    ]
    return merge(
        lying, *flowers, *(_build_ball(number, height, time) for number in range(len(BALLS)))
    )


@cache
def _build_pads() -> Shape:
    """Round leaves with a notch, in groups around the flowers; z is the height above the water."""
    random = np.random.default_rng(12)
    discs: list[tuple[float, float, float]] = []
    while len(discs) < 15:
        middle = FLOWERS[len(discs) % 3 if len(discs) < 13 else 0]
        x, y = random.normal(middle[:2], 0.48)
        radius = random.uniform(0.13, 0.3)
        clear_of_pads = all(np.hypot(x - a, y - b) > 0.93 * (radius + r) for a, b, r in discs)
        clear_of_balls = all(np.hypot(x - a, y - b) > radius + r for a, b, r, _ in BALLS)
        if clear_of_pads and clear_of_balls and max(abs(x), abs(y)) + radius < 2.95:
            discs.append((x, y, radius))
    return merge(*(_build_pad(x, y, r, random.uniform(0, 6)) for x, y, r in discs))


def _build_pad(
    x: float, y: float, radius: float, turn: float, rings: int = 4, sides: int = 26
) -> Shape:
    angle = turn + np.linspace(0.16, 2 * np.pi - 0.16, sides + 1)
    distance = radius * np.linspace(0.02, 1, rings + 1)
    wavy = 1 + 0.03 * np.sin(7 * angle)
    rim = 0.05 * radius * (distance / radius) ** 6  # turned up at the edge
    at = np.stack(
        [
            x + distance[:, None] * np.cos(angle) * wavy,
            y + distance[:, None] * np.sin(angle) * wavy,
            np.broadcast_to(rim[:, None], (rings + 1, sides + 1)),
        ],
        -1,
    )
    row = np.arange(rings)[:, None] * (sides + 1) + np.arange(sides)
    a, b, c, d = (k.ravel() for k in (row, row + sides + 1, row + sides + 2, row + 1))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).astype(np.uint32)
    shape = Shape(
        at.reshape(-1, 3).astype(np.float32), faces, np.zeros((at[..., 0].size, 2), np.float32)
    )
    return paint(
        shape, np.array([0, 1, 2, 1, 3])[: rings + 1].repeat(sides + 1), len(FLOATING_COLOURS)
    )


@cache
def _build_flower() -> Shape:
    """Three whorls of pointed petals around a yellow heart, of radius one."""
    petals = []
    for whorl, (count, rise, length) in enumerate(((9, 0.35, 1.0), (8, 0.75, 0.85), (6, 1.1, 0.7))):
        for number in range(count):
            turn = 2 * np.pi * (number + 0.5 * whorl) / count
            ahead = np.array([np.cos(turn), np.sin(turn), 0])
            side = np.array([-ahead[1], ahead[0], 0])
            lift = np.array([0, 0, 1.0])
            root = 0.12 * ahead
            waist = root + length * 0.55 * (np.cos(rise) * ahead + 0.8 * np.sin(rise) * lift)
            tip = root + length * (np.cos(rise) * ahead + np.sin(rise + 0.25) * lift)
            petal = quads(root, waist + 0.22 * side - root, waist - 0.22 * side - root)
            petal.vertices[2] = tip
            petals.append(paint(petal, 5 if whorl == 2 else 4, len(FLOATING_COLOURS)))
    heart = paint(transform(icosphere(2), (0, 0, 0.25), scale=0.2), 6, len(FLOATING_COLOURS))
    return merge(*petals, heart)


def _build_ball(number: int, height: HeightField, time: float) -> Shape:
    """A ball with a pale belt that bobs with the water, at a time."""
    x, y, radius, colour = BALLS[number]
    level = float(height(np.array(x), np.array(y), time))
    sphere = icosphere(4)
    colours = np.where(np.abs(sphere.vertices[:, 2]) < 0.2, 8, colour)
    tilt = rotation_matrix(
        (np.cos(number), np.sin(number), 0), 0.5 + 0.2 * np.sin(2 * np.pi * time / 40 + number)
    )
    at = (x, y, 1.6 * level + 0.35 * radius)
    return transform(paint(sphere, colours, len(FLOATING_COLOURS)), at, tilt, radius)
