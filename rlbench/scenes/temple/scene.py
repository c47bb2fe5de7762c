"""Temple: arcades lit by the sun through pierced screens and by glowing alabaster panes.

It tests indirect light, glossy floors, small patches of sun, and moving cloth, brass and glass.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlbench.render.scene import Camera, Mesh, Scene
from rlbench.scenes.parts.materials import diffuse_bsdf, metal_bsdf, polished_bsdf, rgb
from rlbench.scenes.parts.primitives import boxes, quads
from rlbench.scenes.parts.shape import Float32Array, Point3, Shape, merge
from rlbench.scenes.parts.takes import cut_take, frozen_take, static_camera_take
from rlbench.scenes.parts.textures import (
    Colour,
    bitmap_texture,
    mix_colours,
    noise_pixels,
    tile_pixels,
)
from rlbench.scenes.temple import arcades, furnishings, stone
from rlbench.scenes.temple.stone import HALF_WIDTH, HEIGHT, LENGTH, WALL_THICKNESS
from rlbench.scenes.temple.textures import (
    banner_texture,
    marble_pixels,
    pavement_pixels,
    wood_pixels,
)

__all__ = ["scene"]

ALABASTER_RADIANCE = (3.4, 2.8, 2.0)  # alabaster in the sun
DOOR_RADIANCE = (2.4, 3.0, 3.8)  # sky seen through the door


def scene() -> Scene:
    """Nave and aisles with banners, a swinging lamp, and brass rings around a glass ball."""
    random = np.random.default_rng(11)
    return Scene(
        name="temple",
        title="Temple: arcades, sun and alabaster",
        meshes=(
            *_building_meshes(random),
            *_furniture_meshes(random),
            *_daylight_meshes(),
            *_moving_meshes(),
        ),
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
        vertex_animation=_vertex_animation,
        exposure=0.95,
        max_depth=4,
        takes=(
            static_camera_take(_below_lamp_camera, 0.0),
            cut_take(_camera, _altar_camera, "sky1", 1.0, 0.05),  # the sun fades
            frozen_take(_camera, 55.0),
        ),
    )


def _camera(time: float) -> Camera:
    sway = np.sin(2 * np.pi * time / 105)
    y = 1.6 + 3.0 * np.sin(2 * np.pi * time / 170)
    x = 0.9 + 0.9 * sway
    return Camera((x, y, 1.9), (-0.9 + 1.2 * sway, y + 12, 3.1), fov=68)


def _below_lamp_camera(time: float) -> Camera:
    """A camera near the swinging lamp, whose motion is small in other views."""
    return Camera((1.2, 8.4, 2.0), (-0.2, 14.0, 3.4), fov=68)


def _altar_camera(time: float) -> Camera:
    """A camera that looks back to the door and moves across the nave."""
    x = 2.0 - 0.06 * time
    return Camera((x, 23.5, 2.6), (x - 2.2, 8.0, 3.0), fov=68)


def _vertex_animation(time: float) -> dict[str, Float32Array]:
    return {mesh.name: mesh.vertices for mesh in _moving_meshes(time)}


def _building_meshes(random: np.random.Generator) -> tuple[Mesh, ...]:
    pale = mix_colours((0.56, 0.49, 0.39), (0.74, 0.68, 0.58), noise_pixels(random, 256, 0.4))
    warm = mix_colours((0.44, 0.36, 0.26), (0.66, 0.57, 0.44), noise_pixels(random, 256, 0.4))
    mosaic = tile_pixels(random, [(0.95, 0.70, 0.30), (0.9, 0.62, 0.25)], (0.5, 0.3, 0.1), (12, 12))
    return (
        stone.build_walls(random).to_mesh(
            "walls", diffuse_bsdf(bitmap_texture(warm)), smooth=False
        ),
        arcades.build_arcades().to_mesh("columns", diffuse_bsdf(bitmap_texture(pale)), smooth=True),
        _build_ceiling().to_mesh("ceiling", diffuse_bsdf(bitmap_texture(wood_pixels(random)))),
        _build_floor().to_mesh("floor", polished_bsdf(bitmap_texture(pavement_pixels(random)))),
        stone.build_apse_dome().to_mesh(
            "gold", metal_bsdf(bitmap_texture(mosaic), 0.3), smooth=True
        ),
    )


def _daylight_meshes() -> tuple[Mesh, ...]:
    """Alabaster panes behind the screens, and the open door behind the viewer, as light sources."""
    door = quads((3, -3.98, 0.5), (-6, 0, 0), (0, 0, 6))
    return _emissive_mesh(
        "panes", stone.build_window_panes(), ALABASTER_RADIANCE, 1.0
    ), _emissive_mesh("door", door, DOOR_RADIANCE, 0.35)


def _emissive_mesh(name: str, shape: Shape, radiance: Colour, sampling_weight: float) -> Mesh:
    emission = {"type": "area", "radiance": rgb(*radiance), "sampling_weight": sampling_weight}
    return replace(
        shape.to_mesh(name, {"type": "diffuse", "reflectance": rgb(0.1, 0.1, 0.1)}),
        emission=emission,
    )


def _build_ceiling() -> Shape:
    """A coffered ceiling: a slab, beams across and joists along the nave."""
    slab = boxes(
        (-HALF_WIDTH - WALL_THICKNESS, -4.7, HEIGHT),
        (HALF_WIDTH + WALL_THICKNESS, LENGTH + 4.2, HEIGHT + 0.5),
    )
    beams: list[tuple[Point3, Point3]] = [
        ((-HALF_WIDTH, y - 0.25, HEIGHT - 0.5), (HALF_WIDTH, y + 0.25, HEIGHT))
        for y in np.arange(-1.0, LENGTH, 2.0)
    ]
    beams += [((x - 0.1, -4, HEIGHT - 0.3), (x + 0.1, LENGTH, HEIGHT)) for x in np.arange(-5, 6)]
    low, high = zip(*beams, strict=True)
    return merge(slab, boxes(low, high))


def _build_floor() -> Shape:
    """The pavement; its texture spans the width of the temple and repeats with each bay."""
    half_width = HALF_WIDTH + WALL_THICKNESS
    flat = boxes((-half_width, -4.7, -0.4), (half_width, LENGTH + 4.2, 0))
    uv = (flat.vertices[:, :2] + (half_width, 1.0)) / (2 * half_width, 4.0)
    return flat._replace(uv=uv.astype(np.float32))


def _furniture_meshes(random: np.random.Generator) -> tuple[Mesh, ...]:
    green = mix_colours((0.02, 0.07, 0.08), (0.06, 0.24, 0.22), noise_pixels(random, 128, 0.2))
    leaf = mix_colours((0.05, 0.15, 0.03), (0.13, 0.28, 0.06), noise_pixels(random, 64, 0.2))
    return (
        furnishings.build_pedestal_and_altar().to_mesh(
            "pedestal", polished_bsdf(bitmap_texture(marble_pixels(random))), smooth=True
        ),
        furnishings.build_pots().to_mesh("pots", polished_bsdf(bitmap_texture(green)), smooth=True),
        furnishings.build_plants(random).to_mesh(
            "plants", diffuse_bsdf(bitmap_texture(leaf)), smooth=True
        ),
    )


def _moving_meshes(time: float = 0.0) -> tuple[Mesh, ...]:
    """Banners, the lamp with the rings, and the glass ball, at a time."""
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return (
        furnishings.build_banners(time).to_mesh(
            "banners", diffuse_bsdf(banner_texture()), smooth=True
        ),
        furnishings.build_lamp_and_rings(time).to_mesh(
            "brass", metal_bsdf(rgb(0.90, 0.66, 0.32), 0.25), smooth=True
        ),
        furnishings.build_glass_ball(time).to_mesh("crystal", glass, smooth=True),
    )
