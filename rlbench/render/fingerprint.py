"""What the pixels of a scene depend on, as a short hash that two machines agree on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from rlbench.render.pose import Pose
from rlbench.render.scene import Scene

RECIPE = 2  # raised whenever the tracer makes other pixels of the same scene


def fingerprint(scene: Scene, frames: int) -> str:
    """Hash of a scene's shapes, materials, lights, and poses at its first and last frame.

    Also at those around its cuts, and of the lights that change, frame by frame.

    Numbers enter rounded, and arrays as sums, so that the last bit of a sine, which differs from
    one machine to another, does not matter; a change too small to be seen may be missed.
    A user's scene has an `origin` in place of all this.
    """
    if scene.origin:
        return _hash(f"{RECIPE} {scene.origin}")
    words = [f"{RECIPE} {scene.exposure} {scene.depth} {scene.static}", _words(scene.sky)]
    for mesh in scene.meshes:
        words += [mesh.name, str(mesh.smooth), f"{len(mesh.faces)} faces"]
        words += [_words(part) for part in (mesh.uv, mesh.material, mesh.emission)]
    for time in _times(scene, frames):
        pose = Pose.of(scene, time)
        words += [_words([pose.axes(), pose.camera.origin, pose.camera.fov, *pose.vertices])]
    factors = [scene.lights(float(time)) for time in range(frames)]
    words += [f"lights {_words(factors)}"] * any(factors)
    return _hash("\n".join(words))


def _times(scene: Scene, frames: int) -> list[float]:
    """Frames whose poses tell a scene from another: the first, the last, and those at its cuts."""
    cuts = [cut for cut in scene.cuts if cut < frames]
    return [0.0, frames - 1.0, *(float(time) for cut in cuts for time in (cut - 1, cut))]


def _hash(words: str) -> str:
    return hashlib.blake2b(words.encode(), digest_size=8).hexdigest()


def _words(value: Any) -> str:
    if isinstance(value, Mapping):
        return " ".join(f"{key}: {_words(part)}" for key, part in sorted(value.items()))
    if isinstance(value, np.ndarray):
        return f"{value.shape} {_moments(value.astype(np.float64).reshape(-1))}"
    if isinstance(value, list | tuple):
        return f"[{' '.join(map(_words, value))}]"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _moments(values: np.ndarray) -> str:
    """Mean, mean square, and mean against a ramp that notices a changed order; three digits."""
    scale = np.abs(values).max(initial=0.0)
    if scale == 0:
        return "0"
    unit = values / scale
    ramp = np.linspace(0.0, 1.0, len(unit))
    moments = [unit.mean(), (unit**2).mean(), (unit * ramp).mean()]
    return f"{scale:.4g} " + " ".join(f"{round(m, 4) + 0.0:.4f}" for m in moments)
