"""Random places without light or objects: a room, a columned hall, open ground, a shallow pool."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scenes.generator.solids import (
    Aperture,
    build_block_stack,
    build_box,
    build_foliage,
    build_walls,
    opening_row,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Shape,
    cylinder,
    grid,
    merge,
    transform,
    yaw_matrix,
)

Disc = tuple[float, float, float]  # x, y, radius of a circle on the floor, metres


@dataclass(frozen=True)
class Place:
    """A setting without light or objects, centred on the origin; lengths are metres."""

    half_size: tuple[float, float]  # x and y lie in [-half_size, half_size]
    camera_half_size: tuple[float, float]  # the same bounds for the camera
    eye_heights: tuple[float, float]  # range of camera heights
    gaze_heights: tuple[float, float]  # range of heights of the focus
    lamp_height: float  # height at which lamps hang
    shell: dict[str, Shape]  # fixed parts, by the name of their material
    occupied: tuple[Disc, ...] = ()  # where objects cannot stand
    apertures: tuple[Aperture, ...] = ()
    has_roof: bool = False
    floor_height: float = 0.0
    lamp_scale: float = 1.0  # factor on the size and number of lamps
    camera_clearance: float = 1.4  # smallest distance between objects and the camera
    object_scale: float = 1.0  # factor on the size and number of objects


def draw_room(rng: Generator, light_kind: str) -> Place:
    """A closed room with windows in one wall, or in two walls if daylight is the only light."""
    half_size, height = (rng.uniform(2.0, 3.5), rng.uniform(2.4, 4.5)), rng.uniform(2.4, 3.4)
    is_day = light_kind in ("sky", "sun", "sunsky")
    windows = {
        k: opening_row(
            rng, 2 * half_size[k % 2] - 0.4, rng.uniform(0.8, 1.8), 0.4 if is_day else 1.5, height
        )
        for k in rng.choice(4, 2 if is_day else 1, replace=False)
    }
    shell, apertures = build_walls(
        half_size, height, rng.uniform(0.1, 0.35), windows, has_roof=True
    )
    bounds = (half_size[0] - 0.35, half_size[1] - 0.35)
    return Place(
        half_size, bounds, (1.0, 1.9), (0.4, 1.2), height, shell, (), apertures, has_roof=True
    )


def draw_hall(rng: Generator, light_kind: str) -> Place:
    """A long hall with two rows of columns and slits in its long walls and perhaps in its roof."""
    half_size, height = (rng.uniform(3.5, 6), rng.uniform(7, 12)), rng.uniform(4, 7)
    slits = {
        k: opening_row(rng, 2 * half_size[1] - 1, rng.uniform(0.4, 0.9), 0.7, height)
        for k in (1, 3)
    }
    if rng.random() < 0.5 and light_kind not in ("lamps", "bulbs"):
        slits[4] = opening_row(
            rng, 2 * half_size[0] - 1, rng.uniform(0.3, 0.9), 0.5, 2 * half_size[1]
        )
    shell, apertures = build_walls(half_size, height, rng.uniform(0.3, 0.6), slits, has_roof=True)
    radius = rng.uniform(0.15, 0.4)
    row_x = half_size[0] * rng.uniform(0.5, 0.7)
    column = _build_column(rng, radius, height)
    column_y = np.arange(-half_size[1] + 1.2, half_size[1] - 0.8, rng.uniform(1.8, 3.2))
    columns = tuple((side * row_x, float(y), 2.2 * radius) for y in column_y for side in (-1, 1))
    shell["column"] = merge(*(transform(column, [x, y, 0]) for x, y, _ in columns))
    bounds = (row_x - 2 * radius - 0.3, half_size[1] - 0.5)
    place = Place(
        half_size, bounds, (1.2, 2.6), (0.8, 0.4 * height), height, shell, columns, apertures, True
    )
    return replace(place, camera_clearance=1.6, object_scale=1.4)


def draw_open_ground(rng: Generator, light_kind: str) -> Place:
    """Open ground to the horizon, ringed by staggered blocks and trees."""
    parts: dict[str, list[Shape]] = {"block": [], "leaf": [], "wood": []}
    trunks = []
    for angle in np.arange(0, 2 * np.pi, rng.uniform(0.35, 0.6)):
        size = rng.uniform(0.8, 2.2)
        direction = np.array([np.cos(angle), np.sin(angle)])
        if rng.random() < 0.5:
            spot = np.append(direction * rng.uniform(10, 14), -0.3)  # its foot below the ground
            parts["block"].append(
                transform(build_block_stack(rng, 3 * size), spot, yaw_matrix(angle))
            )
        elif rng.random() < 0.8:
            x, y = direction * rng.uniform(7.5, 11)
            crown, trunk = _build_tree(rng, size)
            parts["leaf"].append(transform(crown, [x, y, 0]))
            parts["wood"].append(transform(trunk, [x, y, -0.3]))
            trunks.append((float(x), float(y), 0.5))
    parts["ground"] = [_build_ground(rng)]
    shell = {name: merge(*part) for name, part in parts.items() if part}
    place = Place((5.0, 5.0), (5.2, 5.2), (1.2, 2.6), (0.5, 1.3), 5.0, shell, tuple(trunks))
    return replace(place, camera_clearance=1.8, object_scale=1.4)


def draw_pool(rng: Generator, light_kind: str) -> Place:
    """A shallow pool from wall to wall: an open court, or a bath under large lamps or windows."""
    half_size, depth = (rng.uniform(2.2, 4), rng.uniform(2.5, 4.5)), rng.uniform(0.25, 0.7)
    has_roof = light_kind == "lamps" or (light_kind == "sky" and rng.random() < 0.4)
    height = depth + (rng.uniform(2.6, 3.6) if has_roof else rng.uniform(0.4, 2.0))
    openings = {}
    if (
        light_kind == "sky" and has_roof
    ):  # large openings, so that light also reaches the pool floor
        openings[0] = opening_row(rng, 2 * half_size[0] - 0.5, rng.uniform(1.2, 2), 0.4, height)
        openings[4] = opening_row(
            rng, 2 * half_size[0] - 0.5, rng.uniform(1.2, 2), 0.3, 2 * half_size[1]
        )
    walls, apertures = build_walls(half_size, height, 0.25, openings, has_roof)
    shell = {name: transform(shape, [0, 0, -depth]) for name, shape in walls.items()}
    shell["water"] = grid(2 * half_size[0] + 0.1, 2 * half_size[1] + 0.1, (80, 80))
    bounds = (half_size[0] - 0.35, half_size[1] - 0.35)
    place = Place(
        half_size,
        bounds,
        (0.8, 1.9),
        (-0.3, 0.4),
        height - depth,
        shell,
        (),
        apertures,
        has_roof,
        -depth,
    )
    return replace(place, lamp_scale=2.4, camera_clearance=1.0)


PLACES = {"room": draw_room, "hall": draw_hall, "open": draw_open_ground, "water": draw_pool}


def _build_ground(rng: Generator) -> Shape:
    """Gently wavy ground, 60 metres wide, whose rim is stretched towards the horizon."""
    flat = grid(60, 60, (64, 64))
    plane = flat.vertices[:, :2]
    distance = np.abs(plane).max(-1) / 30  # 0 in the middle, 1 at the rim
    swell = np.sin(plane @ rng.normal(size=(2, 5)) * 0.8 + rng.uniform(0, 6, 5)) @ np.ones(5)
    height = (1 - distance**2) * rng.uniform(0, 0.03) * (swell - 5)
    stretched = plane * (1 + 12 * distance[:, None] ** 6)
    return Shape(np.column_stack([stretched, height]).astype(np.float32), flat.faces, stretched)


def _build_column(rng: Generator, radius: float, height: float) -> Shape:
    """A round or rectangular column with foot and head."""
    foot = build_box(3 * radius, 3 * radius, 0.25)
    shaft = (
        cylinder(radius, 0, height) if rng.random() < 0.6 else build_box(2 * radius, radius, height)
    )
    return merge(foot, shaft, transform(foot, [0, 0, height - 0.25]))


def _build_tree(rng: Generator, size: float) -> tuple[Shape, Shape]:
    """The crown and the trunk of a tree."""
    height, radii = 1.8 + size * rng.uniform(0.5, 1), size * rng.uniform(0.65, 1.2, 3)
    crown = build_foliage(rng, int(rng.integers(400, 1100)), radii, rng.uniform(0.12, 0.3))
    return transform(crown, [0, 0, height + radii[2] / 2]), cylinder(0.08 * size, 0, height + 0.5)
