"""Further takes of a test scene: a static camera, a cut with a light change, a frozen scene."""

from __future__ import annotations

from collections.abc import Callable

from rlbench.apps.render.scene import Camera, Take

CUT_FRAME, LIGHT_CHANGE_FRAME = 10, 15  # frames: start of the second shot; light change
CameraFunction = Callable[[float], Camera]


def static_camera_take(camera: CameraFunction, time: float) -> Take:
    """The animated scene, seen by the camera as it stands at one time."""
    return Take("static", lambda _: camera(time))


def frozen_take(camera: CameraFunction, time: float) -> Take:
    """The scene at frame 0, seen by the camera as it stands at one time."""
    return Take("still", lambda _: camera(time), vertex_animation=lambda _: {}, static=True)


def cut_take(
    first: CameraFunction, second: CameraFunction, light: str, before: float, after: float
) -> Take:
    """Two shots; in the second, the factor on a light changes from `before` to `after`."""
    return Take(
        "cut",
        lambda time: first(time) if time < CUT_FRAME else second(time),
        lights=lambda time: {light: before if time < LIGHT_CHANGE_FRAME else after},
        cuts=(CUT_FRAME,),
    )
