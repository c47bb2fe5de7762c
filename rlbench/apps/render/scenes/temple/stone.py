"""Stonework of the temple: block walls with pierced screens, window panes and the apse."""

from __future__ import annotations

from typing import Any

import numpy as np

from rlbench.apps.render.scenes.parts.materials import (
    Pixels,
    bitmap_texture,
    mix_colours,
    noise_pixels,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Shape,
    boxes,
    fluted_column,
    lathe,
    merge,
    quads,
    rotation_matrix,
    transform,
    yaw_matrix,
)
from rlbench.apps.render.scenes.parts.sheets import (
    arch_wall,
    block_wall,
    leaf_blade,
    moulding,
    pierced_screen,
    sheet,
)

CREAM, ROSE = (0.66, 0.58, 0.45), (0.50, 0.24, 0.16)
GREEN, DARK = (0.07, 0.14, 0.10), (0.05, 0.04, 0.04)
HALF_WIDTH, LENGTH, HEIGHT, WALL_THICKNESS = (
    6.0,
    30.0,
    9.0,
    0.5,
)  # metres
NAVE_HALF_WIDTH = 3.3  # metres from the axis to a row of columns
SPRING_HEIGHT = 5.3  # metres: top of columns, foot of arches
COLUMN_Y = np.arange(3.0, 28.0, 4.0)  # metres: columns along the nave
SCREEN_CELL = 0.55  # metres: width of a cell of the pierced screens
WINDOW_Y, WINDOW_HALF_WIDTH = (
    (COLUMN_Y[:-1] + COLUMN_Y[1:]) / 2,
    1.5 * SCREEN_CELL,
)  # metres: windows, one in the middle of each bay
SILL_HEIGHT = {-1.0: 3.4, 1.0: 1.75}  # metres: sills of the windows of each side
HEAD_HEIGHT = 7.8  # metres: head of the windows, a whole number of cells above both sills
TRANSOM_HEIGHT = (
    SILL_HEIGHT[1.0] + 8 * SCREEN_CELL
)  # metres: above it, windows of the sunny side are glazed
APSE_RADIUS = 2.9  # metres; its centre is at the end of the nave


def marble_pixels(random: np.random.Generator, size: int = 256) -> Pixels:
    """Repeating dark marble with pale veins [size size 3]."""
    vein = np.abs(noise_pixels(random, size, 0.8) - 0.5) * 2
    body = mix_colours((0.16, 0.04, 0.03), (0.30, 0.09, 0.07), noise_pixels(random, size, 0.2))
    return np.asarray(body + 0.25 * np.exp(-((vein / 0.035) ** 2)), np.float32)


def wood_pixels(random: np.random.Generator, size: int = 256) -> Pixels:
    """Repeating dark timber with cloudy grain [size size 3]."""
    grain = noise_pixels(random, size, 0.6)
    fine = np.repeat(noise_pixels(random, size, -0.6)[::1, :1], size, axis=1)
    return mix_colours((0.15, 0.075, 0.035), (0.36, 0.20, 0.10), 0.6 * grain + 0.4 * fine)


def pavement_pixels(random: np.random.Generator) -> Pixels:
    """One bay of floor [256 832 3], 13 metres wide and 4 long: slabs, bands and a roundel."""
    y, x = np.indices((256, 832)) + 0.5
    x, y = np.abs(x / 64 - 6.5), np.abs(y / 64 - 2)
    flat = np.empty((256, 832, 3))
    flat[:] = np.where(((x // 0.65 + (y + 0.325) // 0.65) % 2 > 0)[..., None], CREAM, ROSE)
    nave = x < 2.7
    slab = (np.abs(x - y) % 0.7 < 0.35) ^ ((x + y) % 0.7 < 0.35)
    flat[nave] = np.where(slab[..., None], CREAM, (0.46, 0.39, 0.30))[nave]
    for radius, colour in ((1.62, DARK), (1.55, CREAM), (1.42, GREEN), (0.98, CREAM), (0.9, ROSE)):
        flat[np.hypot(x, y) < radius] = colour
    star = np.hypot(x, y) * (1 + 0.35 * np.cos(8 * np.arctan2(y, x))) < 0.55
    flat[star] = CREAM
    flat[nave & (np.hypot(x - 2.0, y - 2.0) < 0.62)] = GREEN
    flat[nave & (np.hypot(x - 2.0, y - 2.0) < 0.42)] = ROSE
    flat[(x > 2.7) & (x < 3.9)] = GREEN
    flat[(np.abs(x - 2.75) < 0.05) | (np.abs(x - 3.85) < 0.05)] = CREAM
    flat[(np.abs(x - 2.62) < 0.05) | (np.abs(x - 3.98) < 0.05)] = DARK
    cloud = np.concatenate([noise_pixels(random, 256, 0.3) for _ in range(4)], 1)[:, :832]
    return np.asarray(flat * (0.7 + 0.6 * cloud), np.float32)


def banner_texture() -> dict[str, Any]:
    """A red banner with gold bands and a sun; one repeat covers the banner."""
    y, x = (np.indices((256, 128)) + 0.5) / 128
    x, y = np.abs(x - 0.5) * 1.05, 2.5 * (1 - y / 2)
    cloth = np.empty((256, 128, 3))
    cloth[:] = (0.34, 0.025, 0.03)
    gold = (0.62, 0.38, 0.09)
    cloth[(np.abs(x - 0.43) < 0.025) | (np.abs(y - 2.2) < 0.03) | (np.abs(y - 0.12) < 0.03)] = gold
    angle, far = np.arctan2(y - 1.15, x), np.hypot(x, y - 1.15)
    cloth[(far < 0.30 + 0.05 * np.cos(12 * angle)) & (far > 0.2)] = gold
    cloth[far < 0.13] = gold
    cloth *= 0.9 + 0.1 * np.indices((256, 128)).sum(0)[..., None] % 2
    return bitmap_texture(cloth)


def build_arcades() -> Shape:
    """Two rows of columns with leafy capitals, round arches and a carved frieze."""
    one = merge(
        fluted_column(SPRING_HEIGHT, 0.5, 72, 18), _build_capital_leaves(SPRING_HEIGHT, 0.5)
    )
    span = merge(
        arch_wall(1.28, 2.0, SPRING_HEIGHT, HEIGHT, 0.7), moulding(1.28, 0.26, SPRING_HEIGHT, 0.84)
    )
    first = arch_wall(1.28, 1.5, SPRING_HEIGHT, HEIGHT, 0.7)  # over the half bay at either end
    parts = []
    for x in (-NAVE_HALF_WIDTH, NAVE_HALF_WIDTH):
        parts += [transform(one, (x, y, 0)) for y in COLUMN_Y]
        parts += [transform(span, (x, y, 0), yaw_matrix(np.pi / 2)) for y in WINDOW_Y]
        parts += [transform(first, (x, y, 0), yaw_matrix(np.pi / 2)) for y in (1.5, 28.5)]
        parts.append(boxes((x - 0.35, -4, SPRING_HEIGHT), (x + 0.35, 0, HEIGHT), tile_size=3.0))
        parts.append(_build_frieze(x, -np.sign(x)))
    return merge(*parts)


def _build_capital_leaves(height: float, radius: float) -> Shape:
    """Two rows of eight leaves that bend outward from a capital."""
    foot = height - 1.15 * radius
    leaf = leaf_blade(0.85 * radius, 0.42 * radius, 1.5, 2.1)
    parts = []
    for row, grow in enumerate((0.85, 1.15)):
        for number in range(8):
            angle = (number + row / 2) * np.pi / 4
            at = 0.86 * radius * np.array([np.cos(angle), np.sin(angle), 0]) + (0, 0, foot)
            parts.append(transform(leaf, at, yaw_matrix(angle), grow))
    return merge(*parts)


def _build_frieze(x: float, inward: float) -> Shape:
    """A meander between two mouldings, and dentils below the ceiling, on a wall of the nave."""
    key = [(0, 0, 0.9, 0.1), (0, 0.1, 0.1, 0.6), (0.1, 0.5, 0.8, 0.6), (0.7, 0.2, 0.8, 0.5)]
    key += [(0.3, 0.2, 0.7, 0.3), (0.3, 0.3, 0.4, 0.42)]
    starts = np.arange(-4.0, LENGTH - 0.5, 0.9)
    face = x + 0.35 * inward
    cut = [(face, s + a, 7.45 + b, s + c, 7.45 + d, 0.06) for s in starts for a, b, c, d in key]
    cut += [(face, -4, z, LENGTH, z + 0.12, 0.11) for z in (7.25, 8.12)]
    cut += [(face, y, 8.4, y + 0.14, 8.62, 0.2) for y in np.arange(-4, LENGTH, 0.34)]
    wall, y0, z0, y1, z1, out = np.array(cut).T
    x0, x1 = np.sort([wall - 0.02 * inward, wall + out * inward], axis=0)
    return boxes(np.stack([x0, y0, z0], -1), np.stack([x1, y1, z1], -1), tile_size=3.0)


def build_walls(random: np.random.Generator) -> Shape:
    """Outer walls with screens in their windows, the end walls, the apse and its steps."""
    return merge(
        *(_build_long_wall(random, side) for side in (-1.0, 1.0)),
        *_build_end_walls(),
        _build_apse(),
        *_build_altar_steps(),
    )


def _build_long_wall(random: np.random.Generator, side: float) -> Shape:
    """One long wall: a plain core, blocks in front of it, and screens in its windows."""
    x0, x1 = sorted((side * (HALF_WIDTH + 0.03), side * (HALF_WIDTH + WALL_THICKNESS)))
    starts = np.concatenate([[-4.0], WINDOW_Y + WINDOW_HALF_WIDTH])
    ends = np.concatenate([WINDOW_Y - WINDOW_HALF_WIDTH, [LENGTH]])
    low = SILL_HEIGHT[side]
    parts = [((-4.0, 0.0), (LENGTH, low)), ((-4.0, HEAD_HEIGHT), (LENGTH, HEIGHT))]
    parts += [((a, low), (b, HEAD_HEIGHT)) for a, b in zip(starts, ends, strict=True)]
    core = boxes([(x0, a[0], a[1]) for a, _ in parts], [(x1, b[0], b[1]) for _, b in parts], 3.0)
    flat = merge(*(block_wall(random, *_to_wall_plane(a, b, side)) for a, b in parts))
    rows = int((HEAD_HEIGHT - low) / SCREEN_CELL + 0.01)
    screen = (
        pierced_screen((rows, 3), SCREEN_CELL, 0.245, 0.1) if side > 0 else _build_lattice(rows)
    )
    turn = yaw_matrix(-side * np.pi / 2)
    screens = [
        transform(screen, (side * (HALF_WIDTH + 0.16), y + side * WINDOW_HALF_WIDTH, low), turn)
        for y in WINDOW_Y
    ]
    return merge(core, transform(flat, (side * HALF_WIDTH, 0, 0), turn), *screens)


def _build_lattice(rows: int) -> Shape:
    """A lattice of plain bars, as large as a pierced screen, for the side without sun."""
    x, z = SCREEN_CELL * np.arange(4), SCREEN_CELL * np.arange(rows + 1)
    return boxes(
        [(a - 0.04, -0.05, 0) for a in x] + [(0, -0.04, b - 0.04) for b in z],
        [(a + 0.04, 0.05, rows * SCREEN_CELL) for a in x]
        + [(3 * SCREEN_CELL, 0.04, b + 0.04) for b in z],
    )


def _to_wall_plane(
    low: tuple[float, float], high: tuple[float, float], side: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """A rectangle in (y, z) in the coordinates of the block wall, mirrored for the right wall."""
    return (low, high) if side < 0 else ((-high[0], low[1]), (-low[0], high[1]))


def _build_end_walls() -> tuple[Shape, ...]:
    """The wall behind the viewer, and the wall with the great arch in front of the apse."""
    half_width, top = HALF_WIDTH + WALL_THICKNESS, HEIGHT + 0.5
    plain = boxes(
        [(-half_width, -4.7, 0), (-half_width, LENGTH, 0), (APSE_RADIUS - 0.15, LENGTH, 0)]
        + [(-half_width, LENGTH, SPRING_HEIGHT), (NAVE_HALF_WIDTH, LENGTH, SPRING_HEIGHT)],
        [
            (half_width, -4, top),
            (0.15 - APSE_RADIUS, LENGTH + 0.6, SPRING_HEIGHT),
            (half_width, LENGTH + 0.6, SPRING_HEIGHT),
        ]
        + [(-NAVE_HALF_WIDTH, LENGTH + 0.6, top), (half_width, LENGTH + 0.6, top)],
        tile_size=3.0,
    )
    great = arch_wall(APSE_RADIUS - 0.15, NAVE_HALF_WIDTH, SPRING_HEIGHT - 0.9, top, 0.6)
    band = moulding(APSE_RADIUS - 0.15, 0.32, SPRING_HEIGHT - 0.9, 0.75)
    return plain, *(transform(part, (0, LENGTH + 0.3, 0)) for part in (great, band))


def _build_altar_steps() -> list[Shape]:
    """Three steps up to the altar."""
    return [
        boxes((-2.8 + s, 25.4 + s, 0), (2.8 - s, LENGTH + 1.2, 0.22 + s / 2.4), tile_size=3.0)
        for s in (0, 0.5, 1)
    ]


def _build_apse() -> Shape:
    """A round wall with pilasters, and screens in front of its windows."""
    angle = np.linspace(0, np.pi, 37)
    circle = APSE_RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    round_wall = sheet([circle, circle + (0, 0, SPRING_HEIGHT - 0.9)], 3.0)
    pilaster = boxes((-0.14, -0.12, 0), (0.14, 0.1, SPRING_HEIGHT - 1.1), tile_size=3.0)
    ledge = lathe(
        [
            (APSE_RADIUS - 0.1, 0),
            (APSE_RADIUS - 0.22, 0.1),
            (APSE_RADIUS - 0.22, 0.2),
            (APSE_RADIUS, 0.25),
        ],
        72,
    )
    parts = [round_wall, transform(ledge, (0, 0, SPRING_HEIGHT - 1.15))]
    for at in np.radians([15, 45, 75, 105, 135, 165]):
        place = ((APSE_RADIUS - 0.05) * np.cos(at), (APSE_RADIUS - 0.05) * np.sin(at), 0)
        parts.append(transform(pilaster, place, yaw_matrix(at - np.pi / 2)))
    screen = transform(pierced_screen((7, 2), 0.32, 0.135, 0.06), (-0.32, 0, 1.4))
    parts += [
        transform(
            screen,
            (0.93 * APSE_RADIUS * np.cos(a), 0.93 * APSE_RADIUS * np.sin(a), 0),
            yaw_matrix(a - np.pi / 2),
        )
        for a in np.radians([60, 90, 120])
    ]
    return transform(merge(*parts), (0, LENGTH + 0.6, 0))


def build_window_panes() -> Shape:
    """The panes behind the screens; they face inside."""
    y = WINDOW_Y.repeat(2)
    side = np.tile([-1.0, 1.0], len(WINDOW_Y))
    low = np.where(side < 0, SILL_HEIGHT[-1.0], TRANSOM_HEIGHT)
    corner = np.stack([side * (HALF_WIDTH + 0.4), y + side * WINDOW_HALF_WIDTH, low], -1)
    across = np.stack([0 * y, -2 * side * WINDOW_HALF_WIDTH, 0 * y], -1)
    up = np.stack([0 * y, 0 * y, HEAD_HEIGHT - low], -1)
    a = np.radians([60, 90, 120])
    out, along = (
        np.stack([np.cos(a + turn), np.sin(a + turn), 0 * a], -1) for turn in (0, np.pi / 2)
    )
    middle = np.array([0, LENGTH + 0.6, 1.4]) + 0.97 * APSE_RADIUS * out
    return merge(
        quads(corner, across, up),
        quads(middle + 0.32 * along, -0.64 * along, (0, 0, 7 * 0.32)),
    )


def build_apse_dome() -> Shape:
    """The half dome of the apse, fluted like a shell, with a sun disc in front of it."""
    turn, rise = np.linspace(0, np.pi, 89), np.linspace(0, 0.49 * np.pi, 20)[:, None]
    radius = APSE_RADIUS * (1 - 0.07 * np.abs(np.sin(11 * turn)) * np.cos(rise))
    points = [radius * np.cos(turn) * np.cos(rise), radius * np.sin(turn) * np.cos(rise)]
    dome = sheet(np.stack([*points, radius * np.sin(rise)], -1)[::-1], 1.0)
    disc = lathe([(1.0, 0), (1.0, 0.1), (0.86, 0.14), (0.5, 0.06), (0.3, 0.2), (0.01, 0.28)], 48)
    return merge(
        transform(dome, (0, LENGTH + 0.6, SPRING_HEIGHT - 0.9)),
        transform(disc, (0, 29.6, 2.75), rotation_matrix((1, 0, 0), np.pi / 2)),
    )
