"""Fingerprint of a scene: a hash of everything its pixels depend on, equal on all machines."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from rlbench.apps.render.scene import Pose, Scene

RENDERER_VERSION = 2  # raised whenever the tracer renders different pixels for the same scene


def fingerprint(scene: Scene, frames: int) -> str:
    """16 hex digits that identify shapes, BSDFs, emitters and poses of a scene.

    Poses are compared at the first frame, at the last, and on both sides of each cut; light factors
    at every frame. Numbers are rounded and arrays enter as moments, because the last bit of a sine
    differs between machines; a change too small to be visible may go unnoticed. For a user's scene,
    `Scene.source_hash` replaces all of this.
    """
    if scene.source_hash:
        return _hash(f"{RENDERER_VERSION} {scene.source_hash}")
    lines = [
        f"{RENDERER_VERSION} {scene.exposure} {scene.max_depth} {scene.static}",
        _describe(scene.sky),
    ]
    for mesh in scene.meshes:
        lines += [mesh.name, str(mesh.smooth), f"{len(mesh.faces)} faces"]
        lines += [_describe(part) for part in (mesh.uv, mesh.material, mesh.emission)]
    for time in _compared_times(scene, frames):
        pose = Pose.at_time(scene, time)
        lines += [
            _describe([pose.camera_axes(), pose.camera.origin, pose.camera.fov, *pose.vertices])
        ]
    factors = [scene.lights(float(time)) for time in range(frames)]
    lines += [f"lights {_describe(factors)}"] * any(factors)
    return _hash("\n".join(lines))


def _compared_times(scene: Scene, frames: int) -> list[float]:
    """The first frame, the last, and for each cut the frames before and after it."""
    cuts = [cut for cut in scene.cuts if cut < frames]
    return [0.0, frames - 1.0, *(float(time) for cut in cuts for time in (cut - 1, cut))]


def _hash(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def _describe(value: Any) -> str:
    if isinstance(value, Mapping):
        return " ".join(f"{key}: {_describe(part)}" for key, part in sorted(value.items()))
    if isinstance(value, np.ndarray):
        return f"{value.shape} {_moments(value.astype(np.float64).reshape(-1))}"
    if isinstance(value, list | tuple):
        return f"[{' '.join(map(_describe, value))}]"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _moments(values: np.ndarray) -> str:
    """Scale, then mean, mean square, and mean times a ramp, which depends on the order."""
    scale = np.abs(values).max(initial=0.0)
    if scale == 0:
        return "0"
    unit = values / scale
    ramp = np.linspace(0.0, 1.0, len(unit))
    moments = [unit.mean(), (unit**2).mean(), (unit * ramp).mean()]
    return f"{scale:.4g} " + " ".join(f"{round(m, 4) + 0.0:.4f}" for m in moments)
