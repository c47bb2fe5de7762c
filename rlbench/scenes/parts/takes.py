"""Takes of the test scenes beside the main one: a camera that stands, a cut, or nothing moves."""

from __future__ import annotations

from collections.abc import Callable

from rlbench.render.scene import Camera, Take

CUT, SWITCH = 10, 15  # frames: another shot begins; a light changes
Path = Callable[[float], Camera]


def static(camera: Path, time: float) -> Take:
    """What moves, seen by the camera of one time."""
    return Take("static", lambda _: camera(time))


def still(camera: Path, time: float) -> Take:
    """Everything as at frame 0, seen by the camera of one time."""
    return Take("still", lambda _: camera(time), moving=lambda _: {}, static=True)


def cut(first: Path, second: Path, light: str, before: float, after: float) -> Take:
    """Two shots, in the second of which a light changes from a share of its strength to another."""
    return Take(
        "cut",
        lambda time: first(time) if time < CUT else second(time),
        lights=lambda time: {light: before if time < SWITCH else after},
        cuts=(CUT,),
    )
