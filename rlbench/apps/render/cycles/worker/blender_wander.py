"""Places short camera paths in the rooms of a scene, by ray casts.

SPDX-License-Identifier: GPL-3.0-or-later
"""

from __future__ import annotations

import collections
import math
import random
from typing import Any

import bpy
import mathutils

ROOM_HEIGHT = (2.0, 6.0)  # metres from a floor to the surface above it
EYE_HEIGHT = (1.2, 1.7)  # metres above the floor
CLEARANCE = 0.35  # metres around the camera without a surface
MEDIAN_DEPTH = 1.0  # metres, at least
DEPTH_SPREAD = 1.6  # the 90th percentile of depth over the 10th, at least
MAX_MISSES = 0.05  # fraction of rays that meet no surface, in each image
GRID = 12  # rays along each side of an image
TRIES = 4000  # places and headings for each path
CHOICE = 8  # paths of which the one that sees most objects is taken
PENETRATIONS = 64  # surfaces that a vertical line is followed through
AROUND = [
    mathutils.Vector(steps).normalized()
    for steps in ((x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1))
    if any(steps)
]


def place_paths(scene: Any, wander: dict[str, Any], start: int) -> dict[str, Any]:
    """Paths along which the camera sees a room and touches nothing.

    `wander` has `seed`, `fov` (horizontal, degrees), and `moves`: one list of matrices for each
    path, relative to a place and a heading. Returns `paths`, camera-to-world matrices in the order
    of `moves`, as many as were found, and `rejected`, the number of tries by reason.
    """
    chance = random.Random(wander["seed"])
    rejected: collections.Counter[str] = collections.Counter()
    _show_rendered(scene)
    scene.frame_set(start)
    rays = _Rays(scene, wander["fov"])
    boxes = [_box(item) for item in scene.objects if item.type == "MESH" and item.visible_get()]
    paths = []
    for moves in wander["moves"] if boxes else []:
        path = _place(rays, [mathutils.Matrix(rows) for rows in moves], boxes, chance, rejected)
        if path is None:
            break
        paths.append([[list(row) for row in matrix] for matrix in path])
    return {"paths": paths, "rejected": dict(rejected.most_common())}


def _place(
    rays: _Rays,
    moves: list[Any],
    boxes: list[tuple[Any, Any]],
    chance: random.Random,
    rejected: collections.Counter[str],
) -> list[Any] | None:
    """Camera-to-world matrices of one path: of several places, where most objects are in view."""
    found: list[tuple[int, list[Any]]] = []
    for _ in range(TRIES):
        eye = rays.stand(chance.choice(boxes), chance)
        if eye is None:
            rejected["no floor below a ceiling"] += 1
            continue
        heading = mathutils.Matrix.Rotation(chance.uniform(-math.pi, math.pi), 4, "Z")
        path = [mathutils.Matrix.Translation(eye) @ heading @ move for move in moves]
        reason = next(filter(None, map(rays.reason_against, path)), None)
        if reason:
            rejected[reason] += 1
            continue
        found.append((len(rays.objects(path[0])), path))
        if len(found) == CHOICE:
            break
    return max(found, key=lambda pair: pair[0])[1] if found else None


class _Rays:
    """Rays through what a scene renders at the current frame."""

    def __init__(self, scene: Any, fov: float) -> None:
        self.scene = scene
        self.graph = bpy.context.evaluated_depsgraph_get()
        slope = math.tan(math.radians(fov) / 2)
        steps = [((i + 0.5) / GRID * 2 - 1) * slope for i in range(GRID)]
        self.film = [mathutils.Vector((x, y, -1)) for x in steps for y in steps]

    def depth(self, origin: Any, direction: Any) -> float | None:
        """Distance along a unit direction to the next surface, or None."""
        hit, place, *_ = self.scene.ray_cast(self.graph, origin, direction)
        return (place - origin).length if hit else None

    def objects(self, matrix: Any) -> set[str]:
        """The names of the objects in view of a camera-to-world matrix."""
        eye, turn = matrix.to_translation(), matrix.to_3x3()
        hits = (
            self.scene.ray_cast(self.graph, eye, (turn @ towards).normalized())
            for towards in self.film
        )
        return {hit[4].name for hit in hits if hit[0]}

    def stand(self, box: tuple[Any, Any], chance: random.Random) -> Any | None:
        """Eye height over a floor with a ceiling above, on the vertical through a random point."""
        low, high = box
        x, y = (chance.uniform(low[axis] - 1, high[axis] + 1) for axis in (0, 1))
        height, levels = high[2] + ROOM_HEIGHT[1], []
        for _ in range(PENETRATIONS):
            depth = self.depth(mathutils.Vector((x, y, height)), mathutils.Vector((0, 0, -1)))
            if depth is None:
                break
            levels.append(height - depth)
            height -= depth + 1e-3
        gaps = [upper - lower for upper, lower in zip(levels, levels[1:], strict=False)]
        floors = [
            level
            for level, gap in zip(levels[1:], gaps, strict=True)
            if ROOM_HEIGHT[0] <= gap <= ROOM_HEIGHT[1]
        ]
        if not floors:
            return None
        return mathutils.Vector((x, y, chance.choice(floors) + chance.uniform(*EYE_HEIGHT)))

    def reason_against(self, matrix: Any) -> str | None:
        """Why a camera-to-world matrix shows no room, or None."""
        eye, turn = matrix.to_translation(), matrix.to_3x3()
        near = (self.depth(eye, direction) for direction in AROUND)
        if any(depth is not None and depth < CLEARANCE for depth in near):
            return "a surface is too near"
        depths = [self.depth(eye, (turn @ towards).normalized()) for towards in self.film]
        hits = sorted(depth for depth in depths if depth is not None)
        if len(hits) < (1 - MAX_MISSES) * len(depths):
            return "rays meet no surface"
        if hits[0] < CLEARANCE or hits[len(hits) // 2] < MEDIAN_DEPTH:
            return "a surface is too near"
        if hits[len(hits) * 9 // 10] < DEPTH_SPREAD * hits[len(hits) // 10]:
            return "the view is flat"
        return None


def _show_rendered(scene: Any) -> None:
    """Show what is rendered and hide the rest: rays meet what is shown."""
    for item in (*scene.objects, *bpy.data.collections):
        item.hide_viewport = item.hide_render
    layers = [bpy.context.view_layer.layer_collection]
    for layer in layers:
        layer.hide_viewport = False
        layers.extend(layer.children)
    for item in bpy.context.view_layer.objects:
        item.hide_set(False)


def _box(item: Any) -> tuple[Any, Any]:
    """The least and the greatest corner of an object's bounds in world space."""
    corners = [item.matrix_world @ mathutils.Vector(corner) for corner in item.bound_box]
    low, high = ([pick(c[axis] for c in corners) for axis in range(3)] for pick in (min, max))
    return low, high
