"""Random interiors that are as hard to denoise as real ones: clutter, indirect light, gloss.

Rooms by others are lit through windows, by shielded lamps and by small bulbs, and full of furniture
of all materials. As in `scene.py` beside this file, no test scene is imported or imitated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scene import Camera, Mesh, MitsubaDict, Scene
from rlbench.apps.render.scenes.generator.finishes import FLOORS, METALS, STRETCHED, draw_finishes
from rlbench.apps.render.scenes.generator.interiors import (
    LIGHTS,
    TREATMENTS,
    Interior,
    draw_interior,
    furnish,
)
from rlbench.apps.render.scenes.generator.lights import (
    draw_sky,
    draw_white,
    emissive_mesh,
    emitted_flux,
)
from rlbench.apps.render.scenes.generator.materials import rgb_texture
from rlbench.apps.render.scenes.generator.motion import (
    draw_camera_track,
    draw_movers,
    draw_waving_parts,
)
from rlbench.apps.render.scenes.generator.scene import deal
from rlbench.apps.render.scenes.parts.shapes import Shape, merge

TONES = {"bright": 0.6, "medium": 0.45, "dark": 0.27}  # mean albedo, for the exposure
MOVES = ("walk", "walk", "walk", "dolly", "orbit", "orbit", "pan", "still")
MOTIONS = ("nothing moves", "nothing moves", "objects move", "objects move")
LEVELS = ("0.05", "0.07", "0.1", "0.15", "0.22", "0.3")  # mean linear display value
# fitted to renderings: mean display value over that of an integrating sphere with all flux
GAINS = {"cove": 0.38, "uplight": 0.45, "ajar": 0.11, "bulbs": 0.5, "spots": 0.42}
DAYLIGHT_GAINS = {"sky": 0.75, "sun": 0.85, "panel": 0.6, "mixed": 0.8}
CURTAIN_GAIN = 0.65


def hard_scene(seed: int) -> Scene:
    """The furnished interior of a seed; the same seed always gives the same scene.

    Light, window treatment, tone of the walls, floor, metals, camera move, motion and display level
    are dealt from shuffled packs, so that a few consecutive seeds cover all of them. The exposure
    brings an estimate of the mean radiance to the display level.

    >>> hard_scene(1000).name
    'hard-1000'
    """
    rng = np.random.default_rng([0x4A2D, seed])
    packs = (LIGHTS, TREATMENTS, tuple(TONES), FLOORS, METALS, METALS, MOVES, MOTIONS, LEVELS)
    light, treatment, tone, floor, metal, steel, move, motion, level = (
        deal(seed, pack, 80 + salt) for salt, pack in enumerate(packs)
    )
    interior = draw_interior(rng, light, treatment)
    place = interior.place
    track = draw_camera_track(rng, place, "dolly" if move == "walk" else move)
    movers = draw_movers(rng, place, track, 1) if motion == "objects move" else {}
    pieces = furnish(rng, interior, track, [mover.disc for mover in movers.values()], light)
    parts = {name: merge(*shapes) for name, shapes in pieces.items()}
    lamps = _draw_lamps(rng, parts, light)
    motions = {name: mover.vertices_at for name, mover in movers.items()}
    if motion == "objects move":
        motions |= draw_waving_parts(rng, parts)
    parts |= {name: mover.shape for name, mover in movers.items()}
    parts |= {name: parts[name]._replace(vertices=at(0.0)) for name, at in motions.items()}
    finishes = draw_finishes(rng, tone, floor, (metal, steel))
    meshes = [_draw_mesh(rng, name, part, finishes[name]) for name, part in parts.items()]
    sky, flux = _draw_daylight(rng, interior, light)
    flux += sum(map(emitted_flux, lamps))
    flux *= (GAINS | DAYLIGHT_GAINS)[light]
    if treatment == "curtains" and light in DAYLIGHT_GAINS:
        flux *= CURTAIN_GAIN
    albedo = TONES[tone]
    mean_radiance = flux * albedo / (np.pi * interior.area * (1 - albedo))

    return Scene(
        name=f"hard-{seed}",
        title=f"{light}, {treatment}, {tone}, {floor}, {move}, {motion}",
        meshes=(*meshes, *lamps),
        camera=_walk(track.camera) if move == "walk" else track.camera,
        sky=sky,
        vertex_animation=lambda time: {name: at(time) for name, at in motions.items()},
        exposure=float(level) / mean_radiance * 2 ** rng.uniform(-0.3, 0.3),
        max_depth=10 if "glass" in parts else 8,
        static=not motions and move == "still",
    )


def _draw_lamps(rng: Generator, parts: dict[str, Shape], light: str) -> list[Mesh]:
    """Emissive meshes, taken from the parts, of which bulbs have the smaller flux beside others."""
    lamps = []
    names = [name for name in ("panel", "glow", "bulb") if name in parts]
    for name in names:
        white = draw_white(rng) if name == "panel" else np.array([1, rng.uniform(0.6, 1), 0.5])
        lamp = emissive_mesh(name, parts.pop(name), rgb_texture(white))
        share = rng.uniform(0.2, 0.8) if name == "bulb" and len(names) > 1 else 1.0
        power = 100 * share / emitted_flux(lamp)
        lamps.append(
            replace(lamp, emission={"type": "area", "radiance": rgb_texture(power * white)})
        )
    return lamps


def _draw_daylight(
    rng: Generator, interior: Interior, light: str
) -> tuple[tuple[MitsubaDict, ...], float]:
    """Sky emitters, and their flux through the windows."""
    if light not in ("sky", "sun"):
        return (), 0.0
    place = interior.place
    sky, to_sun, sun_irradiance, sky_radiance = draw_sky(rng, place, light)
    flux = 0.0
    for aperture in place.apertures:
        cosine = max(0.0, float(to_sun @ aperture.outward))
        flux += 0.6 * aperture.area * (np.pi * sky_radiance + sun_irradiance * cosine)
    return sky, flux


def _walk(camera: Callable[[float], Camera]) -> Callable[[float], Camera]:
    """The camera with the bob and sway of a person that walks, a step every 12 frames."""

    def walk(time: float) -> Camera:
        shot, step = camera(time), 2 * np.pi * time / 12
        bob = np.array([0.008 * np.sin(step / 2), 0.008 * np.cos(step / 2), 0.015 * np.sin(step)])
        x, y, z = np.array(shot.origin) + bob
        i, j, k = np.array(shot.target) + 0.5 * bob[[1, 0, 2]]
        return replace(
            shot,
            origin=(float(x), float(y), float(z)),
            target=(float(i), float(j), float(k)),
        )

    return walk


def _draw_mesh(rng: Generator, name: str, part: Shape, material: MitsubaDict) -> Mesh:
    """A mesh with a random size of texture tile, unless its texture is stretched over pieces."""
    tile_size = np.float32(1 if name in STRETCHED else rng.uniform(0.25, 0.9))  # metres
    smooth = name not in ("wall", "floor", "leaf")
    return Mesh(name, part.vertices, part.faces, material, part.uv / tile_size, smooth=smooth)
