"""Random training scenes from a seed: rooms, halls, open ground and shallow pools, and events.

No test scene is imported or imitated. The seed determines shapes, layout, textures, light and
motion, so a method that was trained on these scenes has not seen the test scenes. In eventful
scenes a light is switched, or the camera cuts or hurries.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scene import Camera, Mesh, MitsubaDict, Scene
from rlbench.apps.render.scenes.generator.lights import LIGHT_KINDS, draw_lighting
from rlbench.apps.render.scenes.generator.materials import draw_materials
from rlbench.apps.render.scenes.generator.motion import (
    CAMERA_MOVES,
    draw_camera_track,
    draw_movers,
    draw_waving_parts,
)
from rlbench.apps.render.scenes.generator.objects import scatter_objects
from rlbench.apps.render.scenes.generator.places import PLACES
from rlbench.apps.render.scenes.parts.shapes import Shape, boxes, yaw_matrix

FAMILIES = ("room", "hall", "open", "water")
DISPLAY_GREY = 0.22  # display value to which the exposure maps the estimated mean radiance
EVENTS = ("none", "none", "switch", "switch", "cut", "hurry", "switch and cut", "hurry and switch")
FIRST_EVENT, LAST_EVENT = 3, 10  # frames, of 12, between which an event happens


def scene(seed: int) -> Scene:
    """The training scene of a seed; the same seed always gives the same scene.

    Family, kind of light and camera move are dealt from shuffled packs, so a few consecutive seeds
    cover all of them. Everything else is drawn independently. The exposure follows an estimate of
    the mean radiance, times 2 ** U(-0.7, 0.7).

    >>> scene(0).title
    'water, sky, orbit'
    """
    rng = np.random.default_rng([0x5CE4E, seed])
    family, light_kind, move = (
        deal(seed, pack, salt) for salt, pack in enumerate((FAMILIES, LIGHT_KINDS, CAMERA_MOVES))
    )
    if family == "water":  # few light paths reach a small source through a water surface
        light_kind = {"bulbs": "lamps", "sunsky": "sky"}.get(light_kind, light_kind)
    place = PLACES[family](rng, light_kind)
    lighting = draw_lighting(rng, place, light_kind)
    track = draw_camera_track(rng, place, move)
    movers = {} if move == "frozen" else draw_movers(rng, place, track, int(move == "still"))
    occupied = [*place.occupied, *(mover.disc for mover in movers.values())]
    parts = place.shell | scatter_objects(rng, place, track, occupied, lighting.has_small_sources)
    if light_kind == "sunsky" and place.has_roof:  # the lower half of that sky is black
        parts["ground"] = boxes([-200, -200, -0.6], [200, 200, -0.5])
    motions = draw_waving_parts(rng, parts)
    motions |= {name: mover.vertices_at for name, mover in movers.items()}
    parts |= {name: mover.shape for name, mover in movers.items()}
    parts |= {name: parts[name]._replace(vertices=motion(0.0)) for name, motion in motions.items()}
    if move == "frozen":
        motions = {}
    materials = draw_materials(rng, lighting.has_small_sources)
    meshes = [_draw_mesh(rng, name, part, materials[name]) for name, part in parts.items()]

    return Scene(
        name=f"generated-{seed}",
        title=f"{family}, {light_kind}, {move}",
        meshes=(*meshes, *lighting.lamps),
        camera=track.camera,
        sky=lighting.sky,
        vertex_animation=lambda time: {name: motion(time) for name, motion in motions.items()},
        exposure=DISPLAY_GREY / lighting.mean_radiance * 2 ** rng.uniform(-0.7, 0.7),
        max_depth=10 if any(mesh.material["type"] == "dielectric" for mesh in meshes) else 8,
        static=not motions and move in ("still", "frozen"),
    )


def deal(seed: int, pack: Sequence[str], salt: int) -> str:
    """The card for a seed: each run of len(pack) seeds is dealt one shuffled pack."""
    shuffle, card = divmod(seed, len(pack))
    order = np.random.default_rng([0xDEA1, salt, shuffle]).permutation(len(pack))
    return pack[int(order[card])]


def _draw_mesh(rng: Generator, name: str, part: Shape, material: MitsubaDict) -> Mesh:
    """A mesh with a random size of texture tile."""
    tile_size = np.float32(rng.uniform(0.5, 2.5))  # metres
    smooth = name not in ("leaf", "wall", "floor", "block")
    return Mesh(name, part.vertices, part.faces, material, part.uv / tile_size, smooth=smooth)


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
        eventful = eventful.at_speed(float(rng.uniform(2, 4)))
    if "cut" in event:
        eventful = _cut(eventful, rng)
    if "switch" in event:
        eventful = _switch(eventful, rng)
    return eventful


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
