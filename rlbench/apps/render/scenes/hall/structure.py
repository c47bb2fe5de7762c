"""Structure of the hall: portal frames, wall panels, pipes, desks and the great gate."""

from __future__ import annotations

import numpy as np

from rlbench.apps.render.scenes.hall.lamps import (
    CONSOLES,
    HALF_WIDTH,
    HEIGHT,
    LENGTH,
    RING_Y,
    RING_Z,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Float64Array,
    Shape,
    boxes,
    cylinder,
    lathe,
    merge,
    rotation_matrix,
    transform,
    yaw_matrix,
)
from rlbench.apps.render.scenes.parts.sheets import sheet, torus

Z_TO_MINUS_Y = rotation_matrix((1, 0, 0), np.pi / 2)  # turns an upright shape to face the viewer
Z_TO_Y = rotation_matrix((1, 0, 0), -np.pi / 2)  # turns an upright shape to lie along the hall
FRAME_Y = np.arange(1.0, LENGTH, 4.0)
SLOPE_WIDTH = 2.3  # metres: width and height of the slope between wall and ceiling


def build_floor() -> Shape:
    """The floor slab."""
    return boxes((-HALF_WIDTH, -4, -0.3), (HALF_WIDTH, LENGTH, 0), tile_size=4.0)


def build_shell() -> Shape:
    """Walls, slopes, ceiling and end walls."""
    x, z = HALF_WIDTH, HEIGHT
    corners = [
        (x, 0),
        (x, z - SLOPE_WIDTH),
        (x - SLOPE_WIDTH, z),
        (SLOPE_WIDTH - x, z),
        (-x, z - SLOPE_WIDTH),
        (-x, 0),
    ]
    outline = np.array(corners, float)
    depth = [np.insert(outline, 1, y, axis=1) for y in (-4.2, LENGTH + 0.2)]
    ends = boxes(
        [(-x, LENGTH, 0), (-x, -4.5, 0)], [(x, LENGTH + 0.5, z), (x, -4, z)], tile_size=4.0
    )
    return merge(sheet(np.stack(depth), 4.0), ends)


def build_frames() -> Shape:
    """Portals across the hall, plinths and galleries along it, the gate, and the ring cradle."""
    parts = [transform(_build_portal(0.55, 0.3), (0, y, 0)) for y in FRAME_Y]
    parts += [
        transform(_build_portal(0.8, 0.1), (0, y + d, 0)) for y in FRAME_Y for d in (-0.45, 0.45)
    ]
    low = [
        (-HALF_WIDTH, -4, 3.25),
        (HALF_WIDTH - 0.9, -4, 3.25),
        (-HALF_WIDTH, -4, 0),
        (HALF_WIDTH - 1.3, -4, 0),
    ]
    high = [(0.9 - HALF_WIDTH, LENGTH, 3.5), (HALF_WIDTH, LENGTH, 3.5)]
    high += [(1.3 - HALF_WIDTH, LENGTH, 0.9), (HALF_WIDTH, LENGTH, 0.9)]
    profile = [(2.45, 0.3), (2.45, 1.2), (2.15, 1.3), (2.15, 0.6), (0.5, 0.3), (0.05, 0.9)]
    gate = lathe(profile, 48)
    parts += [
        boxes(low, high),
        transform(gate, (0, LENGTH, RING_Z), Z_TO_MINUS_Y),
        _build_cradle(),
    ]
    return merge(*parts)


def _build_portal(depth: float, half_thickness: float) -> Shape:
    """A frame along walls, slopes and ceiling; `depth` inwards and 2 `half_thickness` along y."""
    outlines = []
    for inset, y in (
        (0.0, -half_thickness),
        (depth, -half_thickness),
        (depth, half_thickness),
        (0.0, half_thickness),
    ):
        x, z, bend = HALF_WIDTH - inset, HEIGHT - inset, SLOPE_WIDTH - 0.586 * inset
        path = [(-x, 0), (-x, z - bend), (bend - x, z), (x - bend, z), (x, z - bend), (x, 0)]
        outlines.append([(a, y, b) for a, b in path])
    return sheet(outlines, 2.0)


def _build_cradle() -> Shape:
    """The cradle of the great rings: a fixed outer ring of blocks on feet."""
    block = boxes((-0.26, -0.5, 2.5), (0.26, 0.5, 2.95))
    turns = [rotation_matrix((0, 1, 0), a) for a in np.arange(16) * (np.pi / 8) + np.pi / 16]
    blocks = [transform(block, (0, 0, 0), turn) for turn in turns]
    band = transform(
        lathe([(2.5, -0.3), (2.75, -0.3), (2.75, 0.3), (2.5, 0.3)], 64), (0, 0, 0), Z_TO_Y
    )
    feet = boxes(
        [(-3.0, -0.7, -RING_Z), (1.2, -0.7, -RING_Z)],
        [(-1.2, 0.7, 0.75 - RING_Z), (3.0, 0.7, 0.75 - RING_Z)],
    )
    return transform(merge(*blocks, band, feet), (0, RING_Y, RING_Z))


def build_panels(random: np.random.Generator) -> Shape:
    """Plates, grilles and housings on the walls, ducts under the ceiling, and desks."""
    low, high = [], []
    for side in (-1.0, 1.0):
        for y in FRAME_Y[:-1] + 0.6:
            for column in range(3):
                for z, height in ((1.0, 1.05), (2.1, 1.05), (3.6, 0.95)):
                    panel = _panel_boxes(random, y + 0.94 * column, z, height)
                    depth = HALF_WIDTH - panel[:, 4]
                    low.append(
                        np.stack([side * HALF_WIDTH + 0 * depth, panel[:, 0], panel[:, 1]], -1)
                    )
                    high.append(np.stack([side * depth, panel[:, 2], panel[:, 3]], -1))
    ends = np.sort(np.stack([np.concatenate(low), np.concatenate(high)]), axis=0)
    ducts = boxes(
        [(-1.9, -4, 6.15), (0.5, -4, 6.35), (-0.3, -4, 6.0)],
        [(-0.9, LENGTH, 6.8), (1.6, LENGTH, 6.8), (0.2, LENGTH, 6.3)],
        tile_size=2.0,
    )
    collars = boxes(
        [(-2.0, y, 6.1) for y in FRAME_Y[:-1] + 2], [(1.7, y + 0.18, 6.9) for y in FRAME_Y[:-1] + 2]
    )
    return merge(boxes(ends[0], ends[1], tile_size=2.0), ducts, collars, *_build_desks())


def _panel_boxes(random: np.random.Generator, y: float, z: float, height: float) -> Float64Array:
    """Boxes [n 5] of (y, z, y, z, depth) in one field of a wall: a plate, a grille, or housings."""
    kind = random.integers(4)
    width = 0.86
    if kind == 0:  # slats
        at = z + np.arange(0.04, height - 0.08, 0.1)
        return np.stack([0 * at + y, at, 0 * at + y + width, at + 0.045, 0 * at + 0.16], -1)
    if kind == 1:  # housings on a plate
        a, b = random.uniform(0.05, 0.5, (2, 5))
        size = random.uniform(0.1, 0.35, (2, 5))
        depth = random.uniform(0.12, 0.3, 5)
        housings = np.stack([y + a, z + b, y + a + size[0], z + b + size[1], depth], -1)
        return np.concatenate([housings, [(y, z, y + width, z + height - 0.08, 0.06)]])
    frame = [(y, z, y + width, z + height - 0.08, random.uniform(0.05, 0.14))]
    if kind == 2:  # a plate with a raised middle
        frame.append((y + 0.15, z + 0.15, y + width - 0.15, z + height - 0.23, frame[0][4] + 0.05))
    return np.array(frame)


def _build_desks() -> list[Shape]:
    """Desks of the consoles, each with an upright board behind its lamps."""
    desk = boxes(
        [(-0.8, 0.02, 0.0), (-0.85, -0.55, 0.0), (-0.8, 0.02, 0.95)],
        [(0.8, 0.5, 0.95), (0.85, 0.02, 0.9), (0.8, 0.14, 1.75)],
    )
    return [transform(desk, (x, y, 0), yaw_matrix(turn)) for x, y, turn in CONSOLES]


def build_pipes() -> Shape:
    """Pipes along the hall with flanges, and pipes that climb the walls beside the frames."""
    runs = [(-3.9, 6.1, 0.24), (-3.3, 6.3, 0.14), (3.7, 6.1, 0.3), (2.9, 6.35, 0.12)]
    runs += [(-6.45, 3.75, 0.14), (6.45, 3.75, 0.14), (-6.75, 4.05, 0.1), (6.75, 4.05, 0.1)]
    parts = [transform(cylinder(r, -4, LENGTH, 20), (x, 0, z), Z_TO_Y) for x, z, r in runs]
    for y in FRAME_Y[:-1] + 3.1:
        parts += [
            transform(torus(r + 0.03, 0.05, 20, 6), (x, y, z), Z_TO_Y)
            for x, z, r in runs
            if r > 0.13
        ]
        parts += [transform(cylinder(0.08, 0.9, 4.6, 12), (x, y + 0.1, 0)) for x in (-6.8, 6.8)]
    return merge(*parts)
