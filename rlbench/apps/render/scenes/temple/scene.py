"""Temple: arcades lit by the sun through pierced screens and by glowing alabaster panes.

It tests indirect light, glossy floors, small patches of sun, and moving cloth, brass and glass.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlbench.apps.render.scene import Camera, Mesh, Scene
from rlbench.apps.render.scenes.parts.materials import (
    Colour,
    bitmap_texture,
    diffuse_bsdf,
    metal_bsdf,
    mix_colours,
    noise_pixels,
    polished_bsdf,
    rgb,
    tile_pixels,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Float32Array,
    Point3,
    Shape,
    boxes,
    cylinder,
    icosphere,
    lathe,
    merge,
    quads,
    rotation_matrix,
    transform,
    yaw_matrix,
)
from rlbench.apps.render.scenes.parts.sheets import leaf_blade, sheet, torus
from rlbench.apps.render.scenes.parts.takes import cut_take, frozen_take, static_camera_take
from rlbench.apps.render.scenes.temple import stone
from rlbench.apps.render.scenes.temple.stone import (
    HALF_WIDTH,
    HEIGHT,
    LENGTH,
    WALL_THICKNESS,
    banner_texture,
    marble_pixels,
    pavement_pixels,
    wood_pixels,
)

LAMP_PIVOT = np.array([-1.9, 6.5, HEIGHT])  # the lamp hangs from it
RING_CENTRE = np.array([0.0, 12.5, 2.4])  # centre of the turning rings
POTS = ((2.25, 6.0), (-2.2, 8.4), (2.2, 17.2), (-2.2, 19.0), (-2.3, 3.4))
BANNERS = (
    (-1.9, 9.0),
    (1.9, 9.0),
    (-1.9, 17.0),
    (1.9, 17.0),
)  # they hang from beams and face the door
ALABASTER_RADIANCE = (3.4, 2.8, 2.0)  # alabaster in the sun
DOOR_RADIANCE = (2.4, 3.0, 3.8)  # sky seen through the door


def build_pots() -> Shape:
    """Glazed pots in the nave."""
    belly = [(0.24, 0.0), (0.27, 0.04), (0.36, 0.22), (0.44, 0.45), (0.43, 0.62), (0.33, 0.76)]
    pot = lathe([*belly, (0.31, 0.82), (0.38, 0.88), (0.37, 0.92), (0.31, 0.9), (0.27, 0.7)], 40)
    return merge(*(transform(pot, (x, y, 0.0)) for x, y in POTS))


def build_plants(random: np.random.Generator) -> Shape:
    """A tuft of long leaves in each pot."""
    leaf = leaf_blade(1.15, 0.15, 1.35, 1.5, steps=10, cup=0.5)
    parts = []
    for x, y in POTS:
        for number in range(26):
            turn = yaw_matrix(2.4 * number) @ rotation_matrix(
                (0, 1, 0), random.uniform(-0.15, 0.55)
            )
            parts.append(transform(leaf, (x, y, 0.72), turn, random.uniform(0.65, 1.1)))
    return merge(*parts)


def build_pedestal_and_altar() -> Shape:
    """The round pedestal below the rings, and the altar."""
    low = [(0.95, 0.0), (0.95, 0.16), (0.75, 0.18), (0.75, 0.34), (0.5, 0.37), (0.4, 0.44)]
    foot = lathe([*low, (0.3, 0.7), (0.28, 0.95), (0.36, 1.1), (0.4, 1.15), (0.01, 1.17)], 64)
    altar = boxes([(-0.9, 29.0, 0.6), (-1.0, 28.9, 1.4)], [(0.9, 29.9, 1.4), (1.0, 30.0, 1.6)])
    return merge(transform(foot, (RING_CENTRE[0], RING_CENTRE[1], 0)), altar)


def build_banners(time: float) -> Shape:
    """Banners at a time; they hang from beams and sway most at their lower ends."""
    across, down = np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(1, 0, 21))
    parts = []
    for number, (x, y) in enumerate(BANNERS):
        phase = 2 * np.pi * time / (31 + 3 * number) + 1.9 * number
        wave = 0.22 * down * np.sin(phase - 2.6 * down) + 0.05 * np.sin(
            5.5 * across + 2.1 * phase - 3 * down
        ) * (0.25 + down)
        tip = 2.5 * down - 0.3 * down**4 * np.abs(2 * across)
        at = np.stack([x + 1.05 * across, y + wave, HEIGHT - 0.75 - tip], -1)
        flag = sheet(at)
        uv = np.stack([across + 0.5, 1 - down], -1).reshape(-1, 2).astype(np.float32)
        parts.append(flag._replace(uv=uv))
    return merge(*parts)


def build_lamp_and_rings(time: float) -> Shape:
    """The swinging lamp, and three nested rings that turn, at a time."""
    swing = rotation_matrix((0.25, 1, 0), 0.2 * np.sin(2 * np.pi * time / 70 + 0.4))
    lamp = [cylinder(0.02, -4.6, 0.0, 8), transform(icosphere(2), (0, 0, -4.75), scale=0.14)]
    lamp += [transform(torus(0.42, 0.035, 40), (0, 0, -5.35))]
    lamp += [
        transform(torus(0.42, 0.03, 32, 8), (0, 0, -5.0), rotation_matrix((0, 1, 0), np.pi / 2))
    ]
    lamp += [
        transform(torus(0.42, 0.03, 32, 8), (0, 0, -5.0), rotation_matrix((1, 0, 0), np.pi / 2))
    ]
    rings = []
    for radius, tilt, period in ((1.15, 1.45, 150.0), (0.98, 0.9, -95.0), (0.82, 0.4, 60.0)):
        turn = yaw_matrix(2 * np.pi * time / period + radius * 7) @ rotation_matrix((1, 0, 0), tilt)
        rim = [(radius, -0.09), (radius + 0.06, -0.09), (radius + 0.06, 0.09), (radius, 0.09)]
        rings.append(transform(lathe([*rim, rim[0]], 56), RING_CENTRE, turn))
    return merge(transform(merge(*lamp), LAMP_PIVOT, swing), *rings)


def build_glass_ball(time: float) -> Shape:
    """The glass ball that drifts within the rings, at a time."""
    angle = 2 * np.pi * time / 60
    return transform(
        icosphere(4), RING_CENTRE + (0.1 * np.cos(angle), 0, 0.1 * np.sin(angle)), scale=0.5
    )


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
        stone.build_arcades().to_mesh("columns", diffuse_bsdf(bitmap_texture(pale)), smooth=True),
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
        build_pedestal_and_altar().to_mesh(
            "pedestal", polished_bsdf(bitmap_texture(marble_pixels(random))), smooth=True
        ),
        build_pots().to_mesh("pots", polished_bsdf(bitmap_texture(green)), smooth=True),
        build_plants(random).to_mesh("plants", diffuse_bsdf(bitmap_texture(leaf)), smooth=True),
    )


def _moving_meshes(time: float = 0.0) -> tuple[Mesh, ...]:
    """Banners, the lamp with the rings, and the glass ball, at a time."""
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return (
        build_banners(time).to_mesh("banners", diffuse_bsdf(banner_texture()), smooth=True),
        build_lamp_and_rings(time).to_mesh(
            "brass", metal_bsdf(rgb(0.90, 0.66, 0.32), 0.25), smooth=True
        ),
        build_glass_ball(time).to_mesh("crystal", glass, smooth=True),
    )
