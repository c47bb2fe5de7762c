"""Generated scenes in which something happens: a light is switched, the camera cuts or hurries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from rlbench.render.scene import Camera, Scene
from rlbench.scenes.generator.scene import deal, scene
from rlbench.scenes.parts.shape import yaw_matrix

__all__ = ["EVENTS", "eventful_scene"]

EVENTS = ("none", "none", "switch", "switch", "cut", "hurry", "switch and cut", "hurry and switch")
FIRST_EVENT, LAST_EVENT = 3, 10  # frames, of 12, between which an event happens


def eventful_scene(seed: int) -> Scene:
    """The generated scene of a seed, with an event dealt from EVENTS.

    At a switch, the radiance of one emitter is multiplied by a factor between 1/8 and 4. At a cut,
    the camera turns by 40 to 140 degrees. A scene that hurries moves 2 to 4 times as fast. The same
    seed always gives the same scene.

    >>> eventful_scene(128).name
    'eventful-128'
    """
    rng = np.random.default_rng([0xE7E27, seed])
    event, still = deal(seed, EVENTS, salt=3), scene(seed)
    eventful = replace(still, name=f"eventful-{seed}", title=f"{still.title}, {event}")
    if "hurry" in event:
        eventful = _hurry(eventful, float(rng.uniform(2, 4)))
    if "cut" in event:
        eventful = _cut(eventful, rng)
    if "switch" in event:
        eventful = _switch(eventful, rng)
    return eventful


def _hurry(still: Scene, speed: float) -> Scene:
    """The scene with all motion `speed` times as fast."""
    return replace(
        still,
        camera=lambda time: still.camera(speed * time),
        vertex_animation=lambda time: still.vertex_animation(speed * time),
    )


def _cut(still: Scene, rng: Generator) -> Scene:
    """The scene with a second shot, in another direction from the same place."""
    frame = _draw_frame(rng)
    angle = rng.choice([-1, 1]) * np.radians(rng.uniform(40, 140))
    turn = _turn(still.camera, float(angle))
    return replace(
        still,
        camera=lambda time: turn(time) if time >= frame else still.camera(time),
        cuts=(frame,),
        static=False,
    )


def _turn(camera: Callable[[float], Camera], angle: float) -> Callable[[float], Camera]:
    """The camera, turned about the vertical through its origin by an angle in radians."""

    def turn(time: float) -> Camera:
        shot = camera(time)
        origin = np.array(shot.origin)
        x, y, z = origin + yaw_matrix(angle) @ (np.array(shot.target) - origin)
        return replace(shot, target=(float(x), float(y), float(z)))

    return turn


def _switch(still: Scene, rng: Generator) -> Scene:
    """The scene with one emitter that is dimmed or brightened from one frame on."""
    lamps = [mesh.name for mesh in still.meshes if mesh.emission is not None]
    emitters = [*lamps, *(f"sky{k}" for k in range(len(still.sky)))]
    emitter, frame = str(rng.choice(emitters)), _draw_frame(rng)
    factor = float(2 ** rng.uniform(-3, 2))
    return replace(still, lights=lambda time: {emitter: factor if time >= frame else 1.0})


def _draw_frame(rng: Generator) -> int:
    return int(rng.integers(FIRST_EVENT, LAST_EVENT))
