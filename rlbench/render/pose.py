"""Where everything is at one moment, and where a point then lies in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.scene import Camera, Scene

BEHIND = 1e-6  # m: a point nearer to the camera plane, or behind it, is projected from here


@dataclass(frozen=True)
class Pose:
    """The camera, and the vertices of each mesh in the scene's order."""

    camera: Camera
    vertices: tuple[Float[Array, "v 3"], ...]

    @classmethod
    def of(cls, scene: Scene, time: float) -> Pose:
        """The pose of `scene` at `time`, in frames."""
        moved = scene.vertex_animation(time)
        return cls(scene.camera(time), tuple(moved.get(m.name, m.vertices) for m in scene.meshes))

    def axes(self) -> Float[Array, "3 3"]:
        """The camera's right, down and forward in world space, unit length, float64."""
        camera = self.camera
        forward = _unit(np.subtract(camera.target, camera.origin, dtype=np.float64))
        right = _unit(np.cross(forward, camera.up))
        return np.stack([right, np.cross(forward, right), forward])

    def slope(self, width: int) -> float:
        """How far a ray leans per pixel: the tangent of half the view, over half the width."""
        return float(np.tan(np.radians(self.camera.fov) / 2) * 2 / width)

    def directions(self, film: Float[Array, "p 2"], height: int, width: int) -> Float[Array, "p 3"]:
        """Unit vectors through film positions in pixels, x right, y down, 0 at the corner."""
        leaning = (film - np.array([width / 2, height / 2])) * self.slope(width)
        towards = np.column_stack([leaning, np.ones(len(film))]) @ self.axes()
        return np.asarray(towards / np.linalg.norm(towards, axis=1, keepdims=True))

    def project(
        self, points: Float[Array, "p 4"], height: int, width: int
    ) -> tuple[Float[Array, "p 2"], Float[Array, " p"]]:
        """Film position in pixels (x right, y down, 0 at the corner), and depth along the view.

        Points are homogeneous: (position, 1), or (direction, 0) for what is infinitely far away.
        """
        seen = (points[:, :3] - points[:, 3:] * np.asarray(self.camera.origin)) @ self.axes().T
        depth = seen[:, 2]
        centre = np.array([width / 2, height / 2])
        film = seen[:, :2] / np.maximum(depth, BEHIND)[:, None] / self.slope(width) + centre
        return film, depth


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
