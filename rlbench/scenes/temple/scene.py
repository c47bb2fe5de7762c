"""Temple: arcades lit by the sun through pierced screens and by panes of glowing alabaster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.parts.shapes import Floats, Shape, boxes, merge, quads
from rlbench.scenes.parts.takes import cut, static, still
from rlbench.scenes.parts.textures import bitmap, diffuse, metal, mix, noise, polished, rgb, tiles
from rlbench.scenes.temple import furnishings, stone
from rlbench.scenes.temple.paint import marble, pavement, wood, woven
from rlbench.scenes.temple.stone import HEIGHT, LENGTH, THICK, WIDTH

Point = tuple[float, float, float]

GLOW = (3.4, 2.8, 2.0)  # radiance of alabaster in the sun
DAY = (2.4, 3.0, 3.8)  # radiance of the sky through the door


def scene() -> Scene:
    """The nave and aisles, banners, a swinging lamp, and brass rings about a ball of glass."""
    random = np.random.default_rng(11)
    return Scene(
        name="temple",
        title="Temple: arcades, sun and alabaster",
        meshes=(*_building(random), *_furniture(random), *_panes(), *_movers()),
        camera=_camera,
        sky=(
            {"type": "constant", "radiance": rgb(0.75, 0.95, 1.2), "sampling_weight": 0.04},
            {
                "type": "directional",
                "direction": [-0.78, 0.22, -0.6],
                "sampling_weight": 1.1,
                "irradiance": rgb(20.0, 16.0, 10.5),
            },
        ),
        vertex_animation=_moving,
        exposure=0.95,
        depth=4,
        takes=(
            static(_below_lamp, 0.0),
            cut(_camera, _from_altar, "sky1", 1.0, 0.05),  # the sun goes
            still(_camera, 55.0),
        ),
    )


def _camera(time: float) -> Camera:
    sway = np.sin(2 * np.pi * time / 105)
    y = 1.6 + 3.0 * np.sin(2 * np.pi * time / 170)
    x = 0.9 + 0.9 * sway
    return Camera((x, y, 1.9), (-0.9 + 1.2 * sway, y + 12, 3.1), fov=68)


def _below_lamp(time: float) -> Camera:
    """Near the swinging lamp, which moves little in the picture from elsewhere."""
    return Camera((1.2, 8.4, 2.0), (-0.2, 14.0, 3.4), fov=68)


def _from_altar(time: float) -> Camera:
    """Back towards the door, moving across the hall."""
    x = 2.0 - 0.06 * time
    return Camera((x, 23.5, 2.6), (x - 2.2, 8.0, 3.0), fov=68)


def _moving(time: float) -> dict[str, Floats]:
    return {mesh.name: mesh.vertices for mesh in _movers(time)}


def _building(random: np.random.Generator) -> tuple[Mesh, ...]:
    pale = mix((0.56, 0.49, 0.39), (0.74, 0.68, 0.58), noise(random, 256, 0.4))
    warm = mix((0.44, 0.36, 0.26), (0.66, 0.57, 0.44), noise(random, 256, 0.4))
    mosaic = tiles(random, [(0.95, 0.70, 0.30), (0.9, 0.62, 0.25)], (0.5, 0.3, 0.1), (12, 12))
    return (
        stone.walls(random).mesh("walls", diffuse(bitmap(warm)), smooth=False),
        stone.arcades().mesh("columns", diffuse(bitmap(pale)), smooth=True),
        _ceiling().mesh("ceiling", diffuse(bitmap(wood(random)))),
        _floor().mesh("floor", polished(bitmap(pavement(random)))),
        stone.shell().mesh("gold", metal(bitmap(mosaic), 0.3), smooth=True),
    )


def _panes() -> tuple[Mesh, ...]:
    """Alabaster that shines behind the screens, and the open door behind the viewer."""
    door = quads((3, -3.98, 0.5), (-6, 0, 0), (0, 0, 6))
    return _shining("panes", stone.windows(), GLOW, 1.0), _shining("door", door, DAY, 0.35)


def _shining(name: str, shape: Shape, colour: Point, weight: float) -> Mesh:
    shine = {"type": "area", "radiance": rgb(*colour), "sampling_weight": weight}
    return replace(
        shape.mesh(name, {"type": "diffuse", "reflectance": rgb(0.1, 0.1, 0.1)}), emission=shine
    )


def _ceiling() -> Shape:
    """A slab, beams across and joists along, so that it is coffered."""
    slab = boxes((-WIDTH - THICK, -4.7, HEIGHT), (WIDTH + THICK, LENGTH + 4.2, HEIGHT + 0.5))
    beams: list[tuple[Point, Point]] = [
        ((-WIDTH, y - 0.25, HEIGHT - 0.5), (WIDTH, y + 0.25, HEIGHT))
        for y in np.arange(-1.0, LENGTH, 2.0)
    ]
    beams += [((x - 0.1, -4, HEIGHT - 0.3), (x + 0.1, LENGTH, HEIGHT)) for x in np.arange(-5, 6)]
    low, high = zip(*beams, strict=True)
    return merge(slab, boxes(low, high))


def _floor() -> Shape:
    """The pavement, whose texture is as wide as the hall and repeats with each bay."""
    wide = WIDTH + THICK
    flat = boxes((-wide, -4.7, -0.4), (wide, LENGTH + 4.2, 0))
    uv = (flat.vertices[:, :2] + (wide, 1.0)) / (2 * wide, 4.0)
    return flat._replace(uv=uv.astype(np.float32))


def _furniture(random: np.random.Generator) -> tuple[Mesh, ...]:
    green = mix((0.02, 0.07, 0.08), (0.06, 0.24, 0.22), noise(random, 128, 0.2))
    leaf = mix((0.05, 0.15, 0.03), (0.13, 0.28, 0.06), noise(random, 64, 0.2))
    return (
        furnishings.pedestal().mesh("pedestal", polished(bitmap(marble(random))), smooth=True),
        furnishings.pots().mesh("pots", polished(bitmap(green)), smooth=True),
        furnishings.plants(random).mesh("plants", diffuse(bitmap(leaf)), smooth=True),
    )


def _movers(time: float = 0.0) -> tuple[Mesh, ...]:
    """Banners, the lamp with the rings, and the crystal, as they are at a time."""
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return (
        furnishings.cloth(time).mesh("banners", diffuse(woven()), smooth=True),
        furnishings.brass(time).mesh("brass", metal(rgb(0.90, 0.66, 0.32), 0.25), smooth=True),
        furnishings.crystal(time).mesh("crystal", glass, smooth=True),
    )
