"""Hall: a dark sci-fi hall of metal and machines, lit by tubes and a thousand small lamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.hall import structure
from rlbench.scenes.hall.lamps import RADIANCE, Lamps, fixed, joined, tubes
from rlbench.scenes.hall.machines import lamps as carried
from rlbench.scenes.hall.machines import machines
from rlbench.scenes.parts.shapes import Shape, boxes, merge, painted, placed, quads, yaw
from rlbench.scenes.parts.takes import cut, static, still
from rlbench.scenes.parts.textures import (
    bitmap,
    diffuse,
    glossy,
    metal,
    mix,
    noise,
    palette,
    polished,
    rgb,
    tiles,
)

TUBE = (0.95, 1.15, 1.36)  # radiance


def scene() -> Scene:
    """The hall: tubes below the ceiling, and a thousand lamps in four meshes, one a colour."""
    random = np.random.default_rng(23)
    return Scene(
        name="hall",
        title="Hall: tubes and a thousand small lamps",
        meshes=(
            *_building(random),
            _crates(random),
            _shining("tubes", tubes(), TUBE, 4.0),
            *_movers(0.0),
        ),
        camera=_camera,
        vertex_animation=lambda time: {mesh.name: mesh.vertices for mesh in _movers(time)},
        exposure=6.0,
        depth=4,
        takes=(
            static(_camera, 20.0),
            cut(_camera, _from_gallery, "tubes", 1.0, 0.0),
            still(_camera, 45.0),
        ),
    )


def _camera(time: float) -> Camera:
    glide = np.sin(2 * np.pi * time / 140)
    x, y = -0.9 + 1.4 * np.sin(2 * np.pi * time / 110), 2.2 + 3.2 * glide
    return Camera((x, y, 1.7), (0.5 + 1.2 * glide, y + 11, 2.7), fov=66)


def _from_gallery(time: float) -> Camera:
    """From above and the other end, moving along the hall."""
    y = 27.0 - 0.1 * time
    return Camera((4.4, y, 4.6), (-1.5, y - 10, 1.8), fov=66)


def _building(random: np.random.Generator) -> tuple[Mesh, ...]:
    slabs = tiles(
        random,
        [(0.050, 0.054, 0.062), (0.040, 0.043, 0.050), (0.065, 0.067, 0.072)],
        (0.012, 0.012, 0.014),
        (4, 4),
        gap=0.02,
    )
    linings = tiles(
        random,
        [(0.16, 0.18, 0.23), (0.20, 0.22, 0.27), (0.27, 0.28, 0.31)],
        (0.02, 0.02, 0.03),
        (4, 3),
        0.5,
        gap=0.05,
    )
    worn = mix((0.42, 0.43, 0.46), (0.68, 0.68, 0.70), noise(random, 256, 0.2))
    dark = mix((0.22, 0.25, 0.29), (0.44, 0.45, 0.48), noise(random, 256, 0.2))
    copper = mix((0.48, 0.26, 0.15), (0.72, 0.45, 0.29), noise(random, 128, 0.2))
    return (
        structure.floor().mesh("floor", polished(bitmap(slabs))),
        structure.shell().mesh("shell", diffuse(bitmap(linings))),
        structure.frames().mesh("ribs", metal(bitmap(worn), 0.32)),
        structure.panels(random).mesh("panels", diffuse(bitmap(dark))),
        structure.pipes().mesh("pipes", metal(bitmap(copper), 0.24), smooth=True),
    )


def _crates(random: np.random.Generator) -> Mesh:
    stacks = [
        (-4.8, 8.4, 1.3),
        (-4.6, 9.9, 1.1),
        (4.5, 8.0, 1.5),
        (4.8, 9.8, 1.2),
        (3.4, 11.5, 0.9),
    ]
    stacks += [
        (-3.3, 13.0, 1.2),
        (-4.9, 14.2, 1.8),
        (4.0, 17.0, 1.9),
        (-4.0, 20.5, 1.6),
        (3.1, 23.0, 1.4),
    ]
    parts = []
    for x, y, size in stacks:
        crate = merge(*_crate(random))
        turn = yaw(random.uniform(-0.5, 0.5))
        parts.append(placed(crate, (x, y, 0), turn, size))
        if random.random() < 0.7:
            at = (x + random.uniform(-0.1, 0.1), y, size)
            parts.append(
                placed(merge(*_crate(random)), at, yaw(random.uniform(-0.6, 0.6)), 0.65 * size)
            )
    shape = merge(*parts)
    colours = [(0.55, 0.16, 0.03), (0.05, 0.20, 0.24), (0.35, 0.33, 0.28), (0.06, 0.06, 0.07)]
    return shape.mesh("crates", glossy(palette(colours), 0.2))


def _crate(random: np.random.Generator) -> tuple[Shape, Shape]:
    """A unit crate in one of three colours with dark edges."""
    body = painted(boxes((-0.47, -0.47, 0.03), (0.47, 0.47, 0.97)), random.integers(3), 4)
    low, high = [], []
    for axis in range(3):
        for a in (0.0, 0.9):
            for b in (0.0, 0.9):
                corner = np.array([a, b, 0.0])
                extent = np.array([0.1, 0.1, 1.0])
                low.append(np.roll(corner, axis))
                high.append(np.roll(corner + extent, axis))
    edges = boxes(np.array(low) - (0.5, 0.5, 0), np.array(high) - (0.5, 0.5, 0))
    return body, painted(edges, 3, 4)


def _movers(time: float) -> tuple[Mesh, ...]:
    """The machines, and all lamps, for the machines carry some."""
    lamps = joined([fixed(np.random.default_rng(5)), carried(time)])
    return (
        machines(time).mesh("machines", metal(rgb(0.70, 0.71, 0.75), 0.2), smooth=True),
        *(_lamp_mesh(lamps, colour) for colour in range(len(RADIANCE))),
    )


def _lamp_mesh(lamps: Lamps, colour: int) -> Mesh:
    """All lamps of one colour; one radiance a mesh, as a texture makes every path dearer."""
    mine = lamps.colour == colour
    shape = quads(lamps.corner[mine], lamps.across[mine], lamps.up[mine], tile=0)
    return _shining(f"lamps{colour}", shape, RADIANCE[colour], 0.5)


def _shining(name: str, shape: Shape, colour: tuple[float, float, float], weight: float) -> Mesh:
    shine = {"type": "area", "radiance": rgb(*colour), "sampling_weight": weight}
    black = {"type": "diffuse", "reflectance": rgb(0.05, 0.05, 0.05)}
    return replace(shape.mesh(name, black), emission=shine)
