"""Bath: a mosaic pool in a tiled room, with a bench, pots, a round mirror and lamps."""

from __future__ import annotations

import numpy as np

from rlbench.render.scene import Mesh
from rlbench.scenes.parts.shapes import (
    Shape,
    ball,
    boxes,
    disc,
    lathe,
    merge,
    painted,
    placed,
    quads,
    rotation,
    yaw,
)
from rlbench.scenes.parts.textures import bitmap, diffuse, glossy, metal, palette, rgb, tiles
from rlbench.scenes.ripples.stones import mosaic, travertine

HALF, DEPTH = 3.0, 0.8  # metres: half the pool's side, and its depth; water stands at z = 0
RIM = 0.45  # metres: width of the coping
WALL = 4.9  # metres from the middle of the pool to the wall behind it
EARTHS = (
    (0.46, 0.42, 0.36),  # 0 pebbles
    (0.30, 0.27, 0.25),
    (0.60, 0.56, 0.50),
    (0.38, 0.28, 0.20),
    (0.16, 0.17, 0.18),
    (0.52, 0.24, 0.13),  # 5 terracotta
    (0.07, 0.16, 0.06),  # 6 leaves, from dark to light
    (0.11, 0.24, 0.07),
    (0.22, 0.33, 0.10),
)
PLINTHS = ((1.15, 0.75, 0.46, 0.22), (-1.75, 1.65, 0.62, 0.46), (2.05, 2.1, 0.5, 0.7))
# x, y, radius, height above the water, of round stones that carry glass


def room(random: np.random.Generator) -> tuple[Mesh, ...]:
    """The pool's floor and sides, the deck with plinths and bench, and the wall."""
    sides = tiles(
        random,
        [(0.10, 0.36, 0.40), (0.14, 0.42, 0.44), (0.08, 0.30, 0.36), (0.20, 0.48, 0.48)],
        (0.45, 0.50, 0.48),
        (12, 12),
        gap=0.08,
    )
    glaze = tiles(
        random,
        [(0.02, 0.13, 0.13), (0.03, 0.17, 0.16), (0.015, 0.10, 0.11), (0.05, 0.20, 0.17)],
        (0.20, 0.19, 0.16),
        (8, 8),
        0.5,
        size=512,
        gap=0.05,
    )
    a, b, d = HALF, HALF + RIM, -DEPTH
    liner = boxes(
        [(-b, -b, d), (a, -b, d), (-a, -b, d), (-a, a, d)],
        [(-a, b, -0.06), (b, b, -0.06), (a, -a, -0.06), (a, b, -0.06)],
        tile=1.2,
    )
    bottom = quads((-a, -a, d), (2 * a, 0, 0), (0, 2 * a, 0), tile=0)
    wall = quads((-14, WALL, 0), (28, 0, 0), (0, 0, 7), tile=1.3)
    return (
        liner.mesh("liner", diffuse(bitmap(sides))),
        bottom.mesh("floor", diffuse(bitmap(mosaic(random)))),
        _stonework().mesh("deck", glossy(bitmap(travertine(random)), 0.22)),
        wall.mesh("wall", glossy(bitmap(glaze), 0.12)),
    )


def _stonework() -> Shape:
    a, b, far = HALF, HALF + RIM, 14.0
    coping = boxes(
        [(-b, -b, -0.06), (a, -b, -0.06), (-a, -b, -0.06), (-a, a, -0.06)],
        [(-a, b, 0.16), (b, b, 0.16), (a, -a, 0.16), (a, b, 0.16)],
        tile=1.5,
    )
    flags = boxes(
        [(-far, -far, -0.4), (b, -far, -0.4), (-b, -far, -0.4), (-b, b, -0.4)],
        [(-b, WALL, 0.1), (far, WALL, 0.1), (b, -b, 0.1), (b, WALL, 0.1)],
        tile=2.4,
    )
    bench = boxes(
        [(-14, WALL - 0.5, 0.1), (-14, WALL - 0.55, 0.5)],
        [(14, WALL, 0.5), (14, WALL, 0.58)],
        tile=2.0,
    )
    pillars = boxes(
        [(x - 0.2, WALL - 0.32, 0.1) for x in (-4.6, -2.3, 2.3, 4.6)],
        [(x + 0.2, WALL, 7.0) for x in (-4.6, -2.3, 2.3, 4.6)],
        tile=2.0,
    )
    stones = [
        placed(
            merge(lathe([(r, -DEPTH), (r, top - 0.03), (r - 0.03, top)], 48), disc(r - 0.03, top)),
            (x, y, 0),
        )
        for x, y, r, top in PLINTHS
    ]
    return merge(coping, flags, bench, pillars, *stones)


def clutter(random: np.random.Generator) -> Mesh:
    """Pebbles that have gathered about the plinths, and plants in pots beside the pool."""
    parts = []
    nests = np.array([(x, y, r) for x, y, r, _ in PLINTHS] + [(-2.5, -2.3, 0.2), (2.4, -1.2, 0.1)])
    for number in range(170):
        x, y, radius = nests[number % len(nests)]
        angle, away = random.uniform(0, 2 * np.pi), radius + 0.08 + random.gamma(1.6, 0.17)
        at = np.clip((x + away * np.cos(angle), y + away * np.sin(angle)), -2.88, 2.88)
        stretch = random.uniform(0.04, 0.11) * np.array([1, random.uniform(0.6, 1), 0.55])
        stone = ball(2)._replace(vertices=(ball(2).vertices * stretch).astype(np.float32))
        turned = placed(stone, (*at, -DEPTH + 0.7 * stretch[2]), yaw(angle))
        parts.append(painted(turned, random.integers(5), len(EARTHS)))
    for x, y, size in ((-3.3, 4.05, 1.15), (3.35, 4.0, 1.0), (-4.1, 3.5, 0.7)):
        parts.append(placed(_agave(random), (x, y, 0.1), scale=size))
    return merge(*parts).mesh("clutter", diffuse(palette(EARTHS)))


def _agave(random: np.random.Generator) -> Shape:
    """A pot of long leaves that arch to all sides."""
    outline = [(0.20, 0), (0.30, 0.42), (0.34, 0.42), (0.34, 0.5), (0.29, 0.5), (0.27, 0.4)]
    pot = painted(lathe(outline, 28), 5, len(EARTHS))
    soil = painted(disc(0.285, 0.44, 28), 1, len(EARTHS))
    blades = []
    for number in range(34):
        turn, rise = 2.4 * number, 0.25 + 1.1 * number / 34
        length = random.uniform(0.7, 1.0)
        along = np.linspace(0, 1, 6)
        out = 0.05 + length * along * np.cos(rise) * (0.6 + 0.5 * along)
        up = 0.45 + length * (along * np.sin(rise) - 0.35 * along**2 * np.cos(rise))
        wide = 0.055 * np.sin(np.pi * (0.12 + 0.86 * along))
        ahead = np.array([np.cos(turn), np.sin(turn)])
        side = np.array([-ahead[1], ahead[0]])
        spine = np.concatenate([out[:, None] * ahead, up[:, None]], -1)
        edge = np.concatenate([wide[:, None] * side, np.zeros((6, 1))], -1)
        left, right = spine - edge, spine + edge
        blade = quads(left[:-1], (right - left)[:-1], np.diff(left, axis=0))
        blade.vertices.reshape(-1, 4, 3)[:, 2] = right[1:]
        blades.append(painted(blade, 6 + number % 3, len(EARTHS)))
    return merge(pot, soil, *blades)


def fittings() -> tuple[Mesh, ...]:
    """A round mirror in a brass ring, and light above, broad enough that paths find it."""
    upright = rotation((1, 0, 0), np.pi / 2)  # a disc that faced up now faces the pool
    glass = placed(disc(1.15, 0, 64), (0.0, WALL - 0.06, 1.95), upright)
    ring = lathe([(1.14, 0), (1.14, 0.1), (1.24, 0.1), (1.28, 0.05), (1.28, 0)], 72)
    around = placed(ring, (0.0, WALL - 0.01, 1.95), upright)
    strips = quads(
        [(-3, -1.55, 3.3), (-3, 0.65, 3.3), (-6, WALL - 0.6, 4.5)],  # the last washes the wall
        [(0, 1.8, 0), (0, 1.8, 0), (0, 0.1, 0)],
        [(6, 0, 0), (6, 0, 0), (12, 0, 0)],
    )
    silver = {"type": "conductor", "specular_reflectance": rgb(0.88, 0.88, 0.86)}
    return (
        glass.mesh("mirror", {"type": "twosided", "bsdf": silver}),
        around.mesh("brass", metal(rgb(0.85, 0.58, 0.26), 0.18)),
        Mesh(
            "lamp",
            strips.vertices,
            strips.faces,
            {"type": "diffuse", "reflectance": rgb(0.1, 0.1, 0.1)},
            uv=strips.uv,
            emission={"type": "area", "radiance": rgb(2.7, 1.95, 1.2)},
        ),
    )
