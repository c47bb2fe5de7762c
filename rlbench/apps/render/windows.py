"""Windows of large frames: training clips with the motion and footprints of frames of many sizes.

A clip shows a window of its own size out of a virtual frame of 192 to 1080 lines. A crop of a
large frame costs as much as a whole small one, and its pixels are those of the large one: textures,
light and motion at that footprint. The window stands still, or moves with a point that it shows.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.fingerprint import fingerprint
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import Pose, Scene, Window

WINDOWS_VERSION = 1  # raised whenever the same clip shows another window
LINES = (192, 1080)  # of virtual frames, drawn in ratio
ASPECTS = (1.0, 4 / 3, 16 / 9)  # of virtual frames
SPEEDS = (1, 1, 2, 4)  # factors on all motion
MOST_MOTION = 40.0  # pixels a frame that at most 5 % of the virtual frame exceed
COARSE = 48  # lines of the frame of which motion is measured


def show_window(scene: Scene, clip: str, frames: int) -> Scene:
    """The scene through a window that is drawn by the clip's name, once it is inspected."""
    source = f"window {WINDOWS_VERSION} {clip} {scene.source_hash or fingerprint(scene, frames)}"

    def inspect(frames: int, size: tuple[int, int]) -> Scene:
        return _draw(scene, clip, frames, size)

    digest = hashlib.blake2b(source.encode(), digest_size=16).hexdigest()
    return replace(scene, inspector=inspect, source_hash=digest)


def _draw(scene: Scene, clip: str, frames: int, size: tuple[int, int]) -> Scene:
    """The scene with a window of `size` pixels (height, width), and a speed that limits motion."""
    key = hashlib.blake2b(clip.encode(), digest_size=8).digest()
    rng = np.random.default_rng([0x31D0, *key])
    lines = max(round(np.exp(rng.uniform(*np.log(LINES)))), size[0])
    width = max(round(lines * rng.choice(ASPECTS)), size[1])
    speed, follows = float(rng.choice(SPEEDS)), rng.random() < 0.5
    position = rng.random(2)  # of the window in the frame, in the middle of the clip
    chosen = scene.at_speed(speed).inspect(frames, (lines, width))
    fastest = _measure_motion(chosen, frames, lines, width)
    if fastest > MOST_MOTION and not scene.xml_file:  # whose paths have a matrix for each frame
        speed *= MOST_MOTION / fastest
        chosen = scene.at_speed(speed).inspect(frames, (lines, width))
    room = np.array([lines - size[0], width - size[1]])
    corner = np.round(position * room)
    centre = corner[::-1] + np.array(size[::-1]) / 2
    shift = _follow(chosen, centre, frames, lines, width) if follows else None

    def window(time: float) -> Window:
        moved = np.clip(np.round(corner + shift(time)), 0, room) if shift else corner
        return Window(lines, width, int(moved[0]), int(moved[1]))

    return replace(chosen, window=window)


def _measure_motion(scene: Scene, frames: int, lines: int, width: int) -> float:
    """The motion that 5 % of the virtual frame exceed in the middle of the clip, in its pixels."""
    tracer = open_tracer(scene, COARSE, max(1, round(COARSE * width / lines)))
    tracer.set_time(float(frames // 2))
    motion = render_gbuffer(tracer, ("motion",))["motion"]
    return float(np.percentile(np.linalg.norm(motion, axis=-1), 95)) * lines / COARSE


def _follow(
    scene: Scene, centre: Float[Array, "2"], frames: int, lines: int, width: int
) -> Callable[[float], Float[Array, "2"]]:
    """How far, in rows and columns, what `centre` (x, y) shows in mid-clip has moved at a time.

    The point stays where it is in the scene. Without a surface it is infinitely far away.
    """
    middle = float(frames // 2)
    tracer = open_tracer(scene, lines, width)
    tracer.set_time(middle)

    def distance(ray: object) -> tuple[object]:
        import drjit as dr

        hit = tracer.mi_scene.ray_intersect_preliminary(ray)
        valid = hit.is_valid()
        return (np.inf,) if valid is False else (dr.select(valid, hit.t, np.inf),)

    reach = float(tracer.evaluate_rays(distance, np.stack([centre, centre]))[0][0])
    ray = tracer.pose.ray_directions(centre[None], lines, width)[0]
    is_near = np.isfinite(reach)
    point = np.array(tracer.pose.camera.origin) + reach * ray if is_near else ray
    homogeneous = np.append(point, float(is_near))[None]

    def shift(time: float) -> Float[Array, "2"]:
        film, _ = Pose.at_time(scene, time).project(homogeneous, lines, width)
        return np.asarray((film[0] - centre)[::-1])

    return shift
