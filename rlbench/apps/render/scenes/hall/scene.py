"""Hall: a dark hall of metal and machines, lit by tubes and about a thousand small lamps.

It tests many lights of different colours, moving lights, rough metal and dark surfaces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlbench.apps.render.scene import Camera, Mesh, Scene
from rlbench.apps.render.scenes.hall import structure
from rlbench.apps.render.scenes.hall.lamps import (
    RADIANCE,
    Lamps,
    build_tubes,
    concatenate_lamps,
    fixed_lamps,
)
from rlbench.apps.render.scenes.hall.machines import build_machines, machine_lamps
from rlbench.apps.render.scenes.parts.materials import (
    Colour,
    bitmap_texture,
    diffuse_bsdf,
    glossy_bsdf,
    metal_bsdf,
    mix_colours,
    noise_pixels,
    palette_texture,
    polished_bsdf,
    rgb,
    tile_pixels,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Shape,
    boxes,
    merge,
    paint,
    quads,
    transform,
    yaw_matrix,
)
from rlbench.apps.render.scenes.parts.takes import cut_take, frozen_take, static_camera_take

TUBE_RADIANCE = (0.95, 1.15, 1.36)  # radiance


def scene() -> Scene:
    """The hall, with its takes: tubes, and the small lamps as one mesh for each of four colours."""
    random = np.random.default_rng(23)
    return Scene(
        name="hall",
        title="Hall: tubes and a thousand small lamps",
        meshes=(
            *_building_meshes(random),
            _crate_mesh(random),
            _emissive_mesh("tubes", build_tubes(), TUBE_RADIANCE, 4.0),
            *_moving_meshes(0.0),
        ),
        camera=_camera,
        vertex_animation=lambda time: {mesh.name: mesh.vertices for mesh in _moving_meshes(time)},
        exposure=6.0,
        max_depth=4,
        takes=(
            static_camera_take(_camera, 20.0),
            cut_take(_camera, _gallery_camera, "tubes", 1.0, 0.0),
            frozen_take(_camera, 45.0),
        ),
    )


def _camera(time: float) -> Camera:
    glide = np.sin(2 * np.pi * time / 140)
    x, y = -0.9 + 1.4 * np.sin(2 * np.pi * time / 110), 2.2 + 3.2 * glide
    return Camera((x, y, 1.7), (0.5 + 1.2 * glide, y + 11, 2.7), fov=66)


def _gallery_camera(time: float) -> Camera:
    """A high camera at the far end that looks back and moves along the hall."""
    y = 27.0 - 0.1 * time
    return Camera((4.4, y, 4.6), (-1.5, y - 10, 1.8), fov=66)


def _building_meshes(random: np.random.Generator) -> tuple[Mesh, ...]:
    slabs = tile_pixels(
        random,
        [(0.050, 0.054, 0.062), (0.040, 0.043, 0.050), (0.065, 0.067, 0.072)],
        (0.012, 0.012, 0.014),
        (4, 4),
        joint_width=0.02,
    )
    linings = tile_pixels(
        random,
        [(0.16, 0.18, 0.23), (0.20, 0.22, 0.27), (0.27, 0.28, 0.31)],
        (0.02, 0.02, 0.03),
        (4, 3),
        0.5,
        joint_width=0.05,
    )
    worn = mix_colours((0.42, 0.43, 0.46), (0.68, 0.68, 0.70), noise_pixels(random, 256, 0.2))
    dark = mix_colours((0.22, 0.25, 0.29), (0.44, 0.45, 0.48), noise_pixels(random, 256, 0.2))
    copper = mix_colours((0.48, 0.26, 0.15), (0.72, 0.45, 0.29), noise_pixels(random, 128, 0.2))
    return (
        structure.build_floor().to_mesh("floor", polished_bsdf(bitmap_texture(slabs))),
        structure.build_shell().to_mesh("shell", diffuse_bsdf(bitmap_texture(linings))),
        structure.build_frames().to_mesh("ribs", metal_bsdf(bitmap_texture(worn), 0.32)),
        structure.build_panels(random).to_mesh("panels", diffuse_bsdf(bitmap_texture(dark))),
        structure.build_pipes().to_mesh(
            "pipes", metal_bsdf(bitmap_texture(copper), 0.24), smooth=True
        ),
    )


def _crate_mesh(random: np.random.Generator) -> Mesh:
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
        crate = merge(*_build_crate(random))
        turn = yaw_matrix(random.uniform(-0.5, 0.5))
        parts.append(transform(crate, (x, y, 0), turn, size))
        if random.random() < 0.7:
            at = (x + random.uniform(-0.1, 0.1), y, size)
            parts.append(
                transform(
                    merge(*_build_crate(random)),
                    at,
                    yaw_matrix(random.uniform(-0.6, 0.6)),
                    0.65 * size,
                )
            )
    shape = merge(*parts)
    colours = [(0.55, 0.16, 0.03), (0.05, 0.20, 0.24), (0.35, 0.33, 0.28), (0.06, 0.06, 0.07)]
    return shape.to_mesh("crates", glossy_bsdf(palette_texture(colours), 0.2))


def _build_crate(random: np.random.Generator) -> tuple[Shape, Shape]:
    """A crate one metre wide, in one of three colours, with dark edges."""
    body = paint(boxes((-0.47, -0.47, 0.03), (0.47, 0.47, 0.97)), random.integers(3), 4)
    low, high = [], []
    for axis in range(3):
        for a in (0.0, 0.9):
            for b in (0.0, 0.9):
                corner = np.array([a, b, 0.0])
                extent = np.array([0.1, 0.1, 1.0])
                low.append(np.roll(corner, axis))
                high.append(np.roll(corner + extent, axis))
    edges = boxes(np.array(low) - (0.5, 0.5, 0), np.array(high) - (0.5, 0.5, 0))
    return body, paint(edges, 3, 4)


def _moving_meshes(time: float) -> tuple[Mesh, ...]:
    """The machines, and all lamps, at a time; the machines carry some of the lamps."""
    lamps = concatenate_lamps([fixed_lamps(np.random.default_rng(5)), machine_lamps(time)])
    return (
        build_machines(time).to_mesh(
            "machines", metal_bsdf(rgb(0.70, 0.71, 0.75), 0.2), smooth=True
        ),
        *(_lamp_mesh(lamps, colour) for colour in range(len(RADIANCE))),
    )


def _lamp_mesh(lamps: Lamps, colour: int) -> Mesh:
    """All lamps of one colour, with constant radiance: a texture costs time in every path."""
    is_colour = lamps.colour == colour
    shape = quads(
        lamps.corner[is_colour], lamps.across[is_colour], lamps.up[is_colour], tile_size=0
    )
    return _emissive_mesh(f"lamps{colour}", shape, RADIANCE[colour], 0.5)


def _emissive_mesh(name: str, shape: Shape, radiance: Colour, sampling_weight: float) -> Mesh:
    emission = {"type": "area", "radiance": rgb(*radiance), "sampling_weight": sampling_weight}
    black = {"type": "diffuse", "reflectance": rgb(0.05, 0.05, 0.05)}
    return replace(shape.to_mesh(name, black), emission=emission)
