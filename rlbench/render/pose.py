"""Camera and vertices of a scene at one time, and the projection of points to the film."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.scene import Camera, Scene

__all__ = ["MIN_DEPTH", "Pose"]

MIN_DEPTH = 1e-6  # m: points nearer to the camera plane, or behind it, are projected from here


@dataclass(frozen=True)
class Pose:
    """The camera, and the vertices of each mesh in the order of `Scene.meshes`."""

    camera: Camera
    vertices: tuple[Float[Array, "v 3"], ...]

    @classmethod
    def at_time(cls, scene: Scene, time: float) -> Pose:
        """The pose of `scene` at `time`, in frames."""
        animated = scene.vertex_animation(time)
        return cls(
            scene.camera(time), tuple(animated.get(m.name, m.vertices) for m in scene.meshes)
        )

    def camera_axes(self) -> Float[Array, "3 3"]:
        """Rows: right, down and forward of the camera in world space, unit length, float64."""
        camera = self.camera
        forward = _normalize(np.subtract(camera.target, camera.origin, dtype=np.float64))
        right = _normalize(np.cross(forward, camera.up))
        return np.stack([right, np.cross(forward, right), forward])

    def tangent_per_pixel(self, width: int) -> float:
        """Tangent of the angle per pixel: tan(fov / 2) divided by half the width."""
        return float(np.tan(np.radians(self.camera.fov) / 2) * 2 / width)

    def ray_directions(
        self, film: Float[Array, "p 2"], height: int, width: int
    ) -> Float[Array, "p 3"]:
        """Unit rays through film positions in pixels (x right, y down, 0 at the corner)."""
        slopes = (film - np.array([width / 2, height / 2])) * self.tangent_per_pixel(width)
        directions = np.column_stack([slopes, np.ones(len(film))]) @ self.camera_axes()
        return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))

    def project(
        self, points: Float[Array, "p 4"], height: int, width: int
    ) -> tuple[Float[Array, "p 2"], Float[Array, " p"]]:
        """Film positions in pixels (x right, y down, 0 at the corner) and depths along the axis.

        Points are homogeneous: (position, 1), or (direction, 0) for points at infinity.
        """
        local = (points[:, :3] - points[:, 3:] * np.asarray(self.camera.origin)) @ (
            self.camera_axes().T
        )
        depth = local[:, 2]
        centre = np.array([width / 2, height / 2])
        slopes = local[:, :2] / np.maximum(depth, MIN_DEPTH)[:, None]
        return slopes / self.tangent_per_pixel(width) + centre, depth


def _normalize(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
