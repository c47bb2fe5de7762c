"""Random motion: camera paths, objects that slide, bob and spin, and waves of water and cloth.

Objects stand on free spots of the floor: clear of occupied discs and of the camera path.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scene import Camera
from rlbench.apps.render.scenes.generator.places import Disc, Place
from rlbench.apps.render.scenes.generator.solids import SOLIDS
from rlbench.apps.render.scenes.parts.shapes import (
    Float32Array,
    Float64Array,
    Shape,
    grid,
    rotation_matrix,
    transform,
    yaw_matrix,
)

VertexMotion = Callable[[float], Float32Array]  # from time in frames to vertices [v 3]
CAMERA_MOVES = ("dolly", "dolly", "orbit", "orbit", "orbit", "pan", "still", "frozen")


def draw_waving_parts(rng: Generator, parts: Mapping[str, Shape]) -> dict[str, VertexMotion]:
    """Motion of the deforming parts: water ripples, and leaves sway in every second scene."""
    motions: dict[str, VertexMotion] = {}
    if "leaf" in parts and rng.random() < 0.5:
        gusts = draw_waves(rng, 3, 2.0, rng.uniform(0.03, 0.12))
        motions["leaf"] = _displace(parts["leaf"], gusts, (1.0, -0.6, 0.3))
    if "water" in parts:
        swell = draw_waves(rng, 6, 1.0, rng.uniform(0.01, 0.05))
        motions["water"] = _displace(parts["water"], swell, (0.0, 0.0, 1.0))
    return motions


def draw_waves(rng: Generator, count: int, length: float, height: float) -> Float64Array:
    """Random plane waves [count 5]: wave vector x y (rad/m), height (m), rad per frame, phase.

    Wavelengths spread by a factor of two about `length`, in metres; crests travel 1 to 4 % of a
    wavelength per frame. The heights sum to `height`, in metres.
    """
    angle, phase = rng.uniform(0, 2 * np.pi, (2, count))
    wavenumber = 2 * np.pi / (length * 2 ** rng.uniform(-1, 1, count))
    speed = 2 * np.pi * rng.uniform(0.01, 0.04, count)
    heights = height / wavenumber / (1 / wavenumber).sum()
    return np.stack(
        [wavenumber * np.cos(angle), wavenumber * np.sin(angle), heights, speed, phase], -1
    )


def wave_height(waves: Float64Array, plane: Float32Array, time: float) -> Float32Array:
    """Height of the waves, in metres, over each point [v 2]; at most the sum of their heights."""
    angle = plane @ waves[:, :2].T + waves[:, 3] * time + waves[:, 4]
    return np.asarray(np.sin(angle) @ waves[:, 2], np.float32)


def _displace(
    part: Shape, waves: Float64Array, direction: tuple[float, float, float]
) -> VertexMotion:
    """Motion that shifts each vertex along `direction` by the height of the waves over it."""
    shift = np.array(direction, np.float32)
    return lambda time: (
        part.vertices + wave_height(waves, part.vertices[:, :2], time)[:, None] * shift
    )


# still: the camera stands while objects move; frozen: nothing moves


class CameraTrack(NamedTuple):
    """A camera path and the space it occupies."""

    camera: Callable[[float], Camera]
    positions: Float64Array  # p 3: samples of the path, metres
    focus: Float64Array  # 3: the point it looks at, metres
    focal_pixels: float  # pixels per radian, for images 192 pixels wide

    @property
    def focus_distance(self) -> float:
        """Metres from the mean camera position to the focus."""
        return float(np.linalg.norm(self.positions.mean(0) - self.focus))


def draw_camera_track(rng: Generator, place: Place, move: str) -> CameraTrack:
    """A camera that swings through the place at 0.5 to 6 pixels a frame, for 192 pixels of width.

    `move` is one of CAMERA_MOVES.
    """
    fov = rng.uniform(50, 78)
    focal_pixels = 96 / np.tan(np.radians(fov / 2))
    bounds = np.array(place.camera_half_size)
    start, focus = _draw_start_and_focus(rng, place)
    speed = 2 ** rng.uniform(-0.8, 2.5) / focal_pixels  # radians a frame
    heading = np.append(rng.normal(size=2), 0.2 * rng.normal())
    heading /= np.linalg.norm(heading)
    focus_share, phase = rng.uniform(0.5, 1), rng.uniform(-0.6, 0.6)
    distance = float(np.linalg.norm(focus - start))

    def pose(swing: float) -> tuple[Float64Array, Float64Array]:
        if move == "dolly":
            step = heading * swing * distance
            return start + step, focus + focus_share * step
        if move == "orbit":
            return focus + yaw_matrix(swing) @ (start - focus), focus
        return start, start + yaw_matrix(swing) @ (focus - start)

    amplitude = min(0.35, 16 * speed) if move in ("dolly", "orbit", "pan") else 0.0
    swings = np.linspace(-1, 1, 9)
    positions = np.array([pose(amplitude * swing)[0] for swing in swings])
    lowest = 0.5 * place.eye_heights[0]
    while (np.abs(positions[:, :2]) > bounds).any() or (positions[:, 2] < lowest).any():
        amplitude *= 0.8
        positions = np.array([pose(amplitude * swing)[0] for swing in swings])
    frequency = min(speed / max(amplitude, 1e-6), 0.4)  # radians a frame

    def camera(time: float) -> Camera:
        origin, target = pose(amplitude * float(np.sin(frequency * time + phase)))
        return Camera(_to_tuple(origin), _to_tuple(target), fov=float(fov))

    return CameraTrack(camera, positions, focus, float(focal_pixels))


def _draw_start_and_focus(rng: Generator, place: Place) -> tuple[Float64Array, Float64Array]:
    """The first camera position, near one end of the place, and the point it looks at."""
    bounds, half_size = np.array(place.camera_half_size), place.half_size
    start = np.append(
        bounds * rng.uniform([-0.8, -0.98], [0.8, -0.7]), rng.uniform(*place.eye_heights)
    )
    focus = np.append(
        np.array(half_size) * rng.uniform(-0.3, 0.3, 2), rng.uniform(*place.gaze_heights)
    )
    if rng.random() < 0.5:  # from the other end
        start[:2] *= -1
    if half_size[1] < 1.7 * half_size[0] and rng.random() < 0.5:  # along the other axis
        start[:2] = start[1::-1] * bounds / bounds[::-1]
    return start, focus


def _to_tuple(point: Float64Array) -> tuple[float, float, float]:
    return float(point[0]), float(point[1]), float(point[2])


def is_blocked(
    spot: Float64Array,
    radius: float,
    occupied: Sequence[Disc],
    track: CameraTrack,
    clearance: float,
) -> bool:
    """True if a disc about a spot overlaps an occupied one, or is too near to the camera path.

    Lengths are metres; `clearance` is the smallest distance allowed between disc and camera.
    """
    overlaps = any(np.hypot(spot[0] - x, spot[1] - y) < radius + r for x, y, r in occupied)
    distance = np.hypot(*(track.positions[:, :2] - spot).T).min() - radius
    return bool(overlaps or distance < clearance)


def footprint_radius(shape: Shape) -> float:
    """Radius of the disc about the origin that holds the shape seen from above, in metres."""
    return float(np.hypot(*shape.vertices[:, :2].T).max())


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
