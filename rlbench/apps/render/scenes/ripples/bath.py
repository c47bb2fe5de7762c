"""Bath: a mosaic pool in a tiled room, with plinths, a bench, potted plants, mirror and lamps."""

from __future__ import annotations

import numpy as np

from rlbench.apps.render.scene import Mesh
from rlbench.apps.render.scenes.parts.materials import (
    Pixels,
    bitmap_texture,
    diffuse_bsdf,
    glossy_bsdf,
    metal_bsdf,
    mix_colours,
    noise_pixels,
    palette_texture,
    rgb,
    tile_pixels,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Shape,
    boxes,
    disc,
    icosphere,
    lathe,
    merge,
    paint,
    quads,
    rotation_matrix,
    transform,
    yaw_matrix,
)

POOL_HALF_WIDTH, POOL_DEPTH = (
    3.0,
    0.8,
)  # metres; the water level is z = 0
COPING_WIDTH = 0.45  # metres: width of the coping
WALL_Y = 4.9  # metres from the centre of the pool to the wall behind it
CLUTTER_COLOURS = (
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


def mosaic_pixels(random: np.random.Generator, cells: int = 120, size: int = 960) -> Pixels:
    """A mosaic of wavy rings [size size 3], pale enough to show the caustics on it."""
    colours = np.array(
        [(0.50, 0.64, 0.60), (0.37, 0.58, 0.58), (0.21, 0.46, 0.51), (0.06, 0.23, 0.34)]
    )
    at = (np.arange(cells) + 0.5) / cells * 2 - 1
    x, y = np.meshgrid(at, at)
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    wave = 9 * radius + 0.55 * np.cos(16 * angle) * (radius > 0.2)
    band = np.array([3, 0, 1, 0, 2, 0, 0, 1, 3, 1, 0, 0, 2, 0])[np.floor(wave).astype(int)]
    border = np.maximum(np.abs(x), np.abs(y)) > 0.94
    stone = colours[np.where(border, 3, band)] * random.uniform(0.8, 1.12, (cells, cells, 1))
    fine = size // cells
    full = stone.repeat(fine, 0).repeat(fine, 1)
    joint = (np.arange(size) % fine == 0)[:, None] | (np.arange(size) % fine == 0)
    return np.asarray(np.where(joint[..., None], np.array([0.42, 0.46, 0.44]), full), np.float32)


def travertine_pixels(random: np.random.Generator) -> Pixels:
    """Slabs of warm travertine [512 512 3] with veins along the rows."""
    slabs = tile_pixels(
        random, [(0.54, 0.46, 0.36), (0.60, 0.52, 0.42)], (0.22, 0.18, 0.14), (3, 2), 0.5, 512, 0.02
    )
    cloud = noise_pixels(random, 512, 0.7)
    across = (np.arange(512) / 512)[:, None, None]
    vein = 0.5 + 0.5 * np.sin(2 * np.pi * (9 * across + 2.6 * cloud))
    return slabs * mix_colours((0.80, 0.76, 0.70), (1.08, 1.06, 1.04), np.asarray(vein, np.float32))


# x, y, radius, height above the water of round stones that carry glass


def room_meshes(random: np.random.Generator) -> tuple[Mesh, ...]:
    """Floor and sides of the pool, the deck with plinths and bench, and the wall."""
    sides = tile_pixels(
        random,
        [(0.10, 0.36, 0.40), (0.14, 0.42, 0.44), (0.08, 0.30, 0.36), (0.20, 0.48, 0.48)],
        (0.45, 0.50, 0.48),
        (12, 12),
        joint_width=0.08,
    )
    glaze = tile_pixels(
        random,
        [(0.02, 0.13, 0.13), (0.03, 0.17, 0.16), (0.015, 0.10, 0.11), (0.05, 0.20, 0.17)],
        (0.20, 0.19, 0.16),
        (8, 8),
        0.5,
        size=512,
        joint_width=0.05,
    )
    a, b, d = POOL_HALF_WIDTH, POOL_HALF_WIDTH + COPING_WIDTH, -POOL_DEPTH
    liner = boxes(
        [(-b, -b, d), (a, -b, d), (-a, -b, d), (-a, a, d)],
        [(-a, b, -0.06), (b, b, -0.06), (a, -a, -0.06), (a, b, -0.06)],
        tile_size=1.2,
    )
    bottom = quads((-a, -a, d), (2 * a, 0, 0), (0, 2 * a, 0), tile_size=0)
    wall = quads((-14, WALL_Y, 0), (28, 0, 0), (0, 0, 7), tile_size=1.3)
    return (
        liner.to_mesh("liner", diffuse_bsdf(bitmap_texture(sides))),
        bottom.to_mesh("floor", diffuse_bsdf(bitmap_texture(mosaic_pixels(random)))),
        _build_deck().to_mesh("deck", glossy_bsdf(bitmap_texture(travertine_pixels(random)), 0.22)),
        wall.to_mesh("wall", glossy_bsdf(bitmap_texture(glaze), 0.12)),
    )


def _build_deck() -> Shape:
    a, b, far = POOL_HALF_WIDTH, POOL_HALF_WIDTH + COPING_WIDTH, 14.0
    coping = boxes(
        [(-b, -b, -0.06), (a, -b, -0.06), (-a, -b, -0.06), (-a, a, -0.06)],
        [(-a, b, 0.16), (b, b, 0.16), (a, -a, 0.16), (a, b, 0.16)],
        tile_size=1.5,
    )
    flags = boxes(
        [(-far, -far, -0.4), (b, -far, -0.4), (-b, -far, -0.4), (-b, b, -0.4)],
        [(-b, WALL_Y, 0.1), (far, WALL_Y, 0.1), (b, -b, 0.1), (b, WALL_Y, 0.1)],
        tile_size=2.4,
    )
    bench = boxes(
        [(-14, WALL_Y - 0.5, 0.1), (-14, WALL_Y - 0.55, 0.5)],
        [(14, WALL_Y, 0.5), (14, WALL_Y, 0.58)],
        tile_size=2.0,
    )
    pillars = boxes(
        [(x - 0.2, WALL_Y - 0.32, 0.1) for x in (-4.6, -2.3, 2.3, 4.6)],
        [(x + 0.2, WALL_Y, 7.0) for x in (-4.6, -2.3, 2.3, 4.6)],
        tile_size=2.0,
    )
    stones = [
        transform(
            merge(
                lathe([(r, -POOL_DEPTH), (r, top - 0.03), (r - 0.03, top)], 48), disc(r - 0.03, top)
            ),
            (x, y, 0),
        )
        for x, y, r, top in PLINTHS
    ]
    return merge(coping, flags, bench, pillars, *stones)


def clutter_mesh(random: np.random.Generator) -> Mesh:
    """Pebbles around the plinths, and potted plants beside the pool."""
    parts = []
    clusters = np.array(
        [(x, y, r) for x, y, r, _ in PLINTHS] + [(-2.5, -2.3, 0.2), (2.4, -1.2, 0.1)]
    )
    for number in range(170):
        x, y, radius = clusters[number % len(clusters)]
        angle, distance = random.uniform(0, 2 * np.pi), radius + 0.08 + random.gamma(1.6, 0.17)
        at = np.clip((x + distance * np.cos(angle), y + distance * np.sin(angle)), -2.88, 2.88)
        stretch = random.uniform(0.04, 0.11) * np.array([1, random.uniform(0.6, 1), 0.55])
        pebble = icosphere(2)._replace(
            vertices=(icosphere(2).vertices * stretch).astype(np.float32)
        )
        lying = transform(pebble, (*at, -POOL_DEPTH + 0.7 * stretch[2]), yaw_matrix(angle))
        parts.append(paint(lying, random.integers(5), len(CLUTTER_COLOURS)))
    for x, y, size in ((-3.3, 4.05, 1.15), (3.35, 4.0, 1.0), (-4.1, 3.5, 0.7)):
        parts.append(transform(_build_agave(random), (x, y, 0.1), scale=size))
    return merge(*parts).to_mesh("clutter", diffuse_bsdf(palette_texture(CLUTTER_COLOURS)))


def _build_agave(random: np.random.Generator) -> Shape:
    """A potted agave with long leaves that arch outward."""
    outline = [(0.20, 0), (0.30, 0.42), (0.34, 0.42), (0.34, 0.5), (0.29, 0.5), (0.27, 0.4)]
    pot = paint(lathe(outline, 28), 5, len(CLUTTER_COLOURS))
    soil = paint(disc(0.285, 0.44, 28), 1, len(CLUTTER_COLOURS))
    blades = []
    for number in range(34):
        turn, rise = 2.4 * number, 0.25 + 1.1 * number / 34
        length = random.uniform(0.7, 1.0)
        along = np.linspace(0, 1, 6)
        out = 0.05 + length * along * np.cos(rise) * (0.6 + 0.5 * along)
        up = 0.45 + length * (along * np.sin(rise) - 0.35 * along**2 * np.cos(rise))
        half_width = 0.055 * np.sin(np.pi * (0.12 + 0.86 * along))
        ahead = np.array([np.cos(turn), np.sin(turn)])
        side = np.array([-ahead[1], ahead[0]])
        spine = np.concatenate([out[:, None] * ahead, up[:, None]], -1)
        edge = np.concatenate([half_width[:, None] * side, np.zeros((6, 1))], -1)
        left, right = spine - edge, spine + edge
        blade = quads(left[:-1], (right - left)[:-1], np.diff(left, axis=0))
        blade.vertices.reshape(-1, 4, 3)[:, 2] = right[1:]
        blades.append(paint(blade, 6 + number % 3, len(CLUTTER_COLOURS)))
    return merge(pot, soil, *blades)


def mirror_and_lamp_meshes() -> tuple[Mesh, ...]:
    """A round mirror in a brass ring, and lamps above, large enough for paths to hit them."""
    upright = rotation_matrix((1, 0, 0), np.pi / 2)  # turns a disc that faces up to face the pool
    mirror = transform(disc(1.15, 0, 64), (0.0, WALL_Y - 0.06, 1.95), upright)
    ring = lathe([(1.14, 0), (1.14, 0.1), (1.24, 0.1), (1.28, 0.05), (1.28, 0)], 72)
    frame = transform(ring, (0.0, WALL_Y - 0.01, 1.95), upright)
    strips = quads(
        [(-3, -1.55, 3.3), (-3, 0.65, 3.3), (-6, WALL_Y - 0.6, 4.5)],  # the last lights the wall
        [(0, 1.8, 0), (0, 1.8, 0), (0, 0.1, 0)],
        [(6, 0, 0), (6, 0, 0), (12, 0, 0)],
    )
    silver = {"type": "conductor", "specular_reflectance": rgb(0.88, 0.88, 0.86)}
    return (
        mirror.to_mesh("mirror", {"type": "twosided", "bsdf": silver}),
        frame.to_mesh("brass", metal_bsdf(rgb(0.85, 0.58, 0.26), 0.18)),
        Mesh(
            "lamp",
            strips.vertices,
            strips.faces,
            {"type": "diffuse", "reflectance": rgb(0.1, 0.1, 0.1)},
            uv=strips.uv,
            emission={"type": "area", "radiance": rgb(2.7, 1.95, 1.2)},
        ),
    )
