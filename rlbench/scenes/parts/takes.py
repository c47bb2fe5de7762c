"""Takes of the test scenes beside the main one: a camera that stands, a cut, or nothing moves."""

from __future__ import annotations

from collections.abc import Callable

from rlbench.render.scene import Camera, Take

CUT_FRAME, LIGHT_CHANGE_FRAME = 10, 15  # frames: another shot begins; a light changes
CameraFunction = Callable[[float], Camera]


def static_camera_take(camera: CameraFunction, time: float) -> Take:
    """What moves, seen by the camera of one time."""
    return Take("static", lambda _: camera(time))


def frozen_take(camera: CameraFunction, time: float) -> Take:
    """Everything as at frame 0, seen by the camera of one time."""
    return Take("still", lambda _: camera(time), vertex_animation=lambda _: {}, static=True)


def cut_take(
    first: CameraFunction, second: CameraFunction, light: str, before: float, after: float
) -> Take:
    """Two shots, in the second of which a light changes from a share of its strength to another."""
    return Take(
        "cut",
        lambda time: first(time) if time < CUT_FRAME else second(time),
        lights=lambda time: {light: before if time < LIGHT_CHANGE_FRAME else after},
        cuts=(CUT_FRAME,),
    )
