"""Random camera paths: dolly, orbit, pan, or a fixed camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from rlbench.render.scene import Camera
from rlbench.scenes.generator.places import Place
from rlbench.scenes.parts.shape import Float64Array, yaw_matrix

CAMERA_MOVES = ("dolly", "dolly", "orbit", "orbit", "orbit", "pan", "still", "frozen")
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
