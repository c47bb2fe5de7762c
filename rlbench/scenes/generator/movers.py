"""Random moving objects: solids that slide, bob and spin, and a cloth that waves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from rlbench.scenes.generator.camera import CameraTrack
from rlbench.scenes.generator.placement import footprint_radius, is_blocked
from rlbench.scenes.generator.places import Disc, Place
from rlbench.scenes.generator.solids import SOLIDS
from rlbench.scenes.generator.waves import VertexMotion, draw_waves, wave_height
from rlbench.scenes.parts.primitives import grid
from rlbench.scenes.parts.shape import (
    Float32Array,
    Float64Array,
    Shape,
    rotation_matrix,
    transform,
    yaw_matrix,
)


class Mover(NamedTuple):
    """A shape, its vertices at each time, and the disc that it never leaves."""

    shape: Shape
    vertices_at: VertexMotion
    disc: Disc


def draw_movers(
    rng: Generator, place: Place, track: CameraTrack, min_count: int
) -> dict[str, Mover]:
    """Up to two sliding objects and a waving cloth near the focus, by name.

    At least `min_count` are drawn; one that finds no free spot in 30 attempts is left out.
    """
    movers: dict[str, Mover] = {}
    names = ["mover0", "mover1", "cloth"][: int(rng.integers(min_count, 4))]
    distance = track.focus_distance
    for name in rng.permutation(names):
        draw_mover = _draw_hanging_cloth if name == "cloth" else _draw_sliding_object
        size = rng.uniform(0.6, 1.1) * place.object_scale
        mover = draw_mover(rng, size, distance / track.focal_pixels * 2 ** rng.uniform(-0.8, 2))
        radius = mover.disc[2]
        bounds = np.maximum(np.array(place.half_size) - radius, 0.0)
        occupied = [*place.occupied, *(other.disc for other in movers.values())]
        for _ in range(30):
            spot = np.clip(track.focus[:2] + 0.8 * rng.normal(size=2), -bounds, bounds)
            if not is_blocked(spot, radius, occupied, track, place.camera_clearance):
                movers[str(name)] = _move_to(mover, np.append(spot, place.floor_height + 0.003))
                break
    return movers


def _move_to(mover: Mover, spot: Float64Array) -> Mover:
    """The mover with its origin at a spot."""
    offset = spot.astype(np.float32)
    disc = (float(spot[0]), float(spot[1]), mover.disc[2])
    return Mover(mover.shape, lambda time: mover.vertices_at(time) + offset, disc)


def _draw_sliding_object(rng: Generator, size: float, speed: float) -> Mover:
    """A solid that slides to and fro, bobs above the floor and spins; `speed` in metres a frame."""
    shape = SOLIDS[rng.integers(len(SOLIDS))](rng, 0.8 * size)
    amplitude = min(size * rng.uniform(0.2, 0.8), 12 * speed)
    frequency, phase = min(speed / amplitude, 0.5), rng.uniform(0, 2 * np.pi)
    heading = yaw_matrix(rng.uniform(0, 2 * np.pi))[0]
    spin = rng.choice([0, -1, 1]) * min(2 * speed / size, 0.15)
    hover_height = rng.uniform(0, 0.8) * size
    bob = rng.uniform(0, 0.9) * min(hover_height, amplitude)

    def vertices_at(time: float) -> Float32Array:
        swing = np.sin(frequency * time + phase)
        rise = np.array([0, 0, hover_height + bob * np.cos(frequency * time)])
        offset = amplitude * swing * heading + rise
        return transform(shape, offset, yaw_matrix(spin * time)).vertices

    return Mover(shape, vertices_at, (0.0, 0.0, amplitude + footprint_radius(shape)))


def _draw_hanging_cloth(rng: Generator, size: float, speed: float) -> Mover:
    """A hanging cloth that waves; its crests move at about `speed` metres a frame."""
    cloth = transform(grid(size, 1.4 * size, (28, 28)), 0, rotation_matrix((1, 0, 0), np.pi / 2))
    facing = yaw_matrix(rng.uniform(0, 2 * np.pi))
    waves = draw_waves(rng, 3, 0.8 * size, 0.12 * size)
    waves[:, 3] = np.hypot(*waves[:, :2].T) * speed / 2
    rise = [0, 0, (0.7 + rng.uniform(0, 0.4)) * size]
    looseness = np.minimum(0.7 - cloth.vertices[:, 2] / size, 1)  # 0 along the pinned upper edge

    def vertices_at(time: float) -> Float32Array:
        push = looseness * wave_height(waves, cloth.vertices[:, ::2], time)
        vertices = cloth.vertices + push[:, None] * np.array([0, 1, 0], np.float32)
        return transform(cloth._replace(vertices=vertices), rise, facing).vertices

    return Mover(cloth, vertices_at, (0.0, 0.0, 0.65 * size))
