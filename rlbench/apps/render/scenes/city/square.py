"""Square: paving, rows of houses, the office tower, the fountain and the street furniture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rlbench.apps.render.scene import Mesh
from rlbench.apps.render.scenes.city import street
from rlbench.apps.render.scenes.city.houses import (
    ATLAS_CELLS,
    BAY_WIDTH,
    HOUSE_COLOURS,
    build_frame,
    build_house,
    build_panes,
    show_atlas_cells,
    window_atlas,
)
from rlbench.apps.render.scenes.city.street import CAR_COLOURS, build_car
from rlbench.apps.render.scenes.city.trees import Tree, build_trunks
from rlbench.apps.render.scenes.parts.glassware import unmerge_vertices
from rlbench.apps.render.scenes.parts.materials import (
    bitmap_texture,
    diffuse_bsdf,
    glossy_bsdf,
    metal_bsdf,
    mix_colours,
    noise_pixels,
    palette_texture,
    rgb,
    tile_pixels,
)
from rlbench.apps.render.scenes.parts.shapes import (
    Shape,
    boxes,
    disc,
    icosphere,
    lathe,
    merge,
    paint,
    quads,
    transform,
    yaw_matrix,
)

SQUARE_HALF_WIDTH = 15.0  # metres from the fountain to the facades
ROAD_RADIUS = 6.6  # metres from the fountain to the middle of the road
OFFICE_POSITION = (16.6, 18.4)  # metres
METAL_COLOURS = ((1.0, 0.78, 0.36), (0.56, 0.57, 0.58), (0.10, 0.11, 0.11))  # gold, aluminium, iron
LAMP_POSTS = ((-8.9, -1.4), (5.6, -8.6), (8.9, 7.4), (-6.8, 8.2))
CAFE_TABLES = ((9.2, 0.2), (11.9, 2.1), (9.6, 3.9))
PARKED_CARS = (
    (-11.8, -0.2, 1.5, 2),
    (-12.0, 4.9, 1.62, 1),
    (-1.0, 12.2, 0.0, 3),
    (4.6, 12.3, 3.14, 2),
)
# x, y, yaw, body colour
LOW_HOUSES = (
    (4, 1, "ochre"),
    (5, 2, "stone"),
    (4, 1, "brick"),
    (6, 2, "ochre"),
)  # bays, storeys, wall material
BENCHES = ((-9.9, -3.6, 1.9), (-4.6, 9.2, 2.6), (4.2, 9.3, -2.7), (11.6, -3.4, -1.7))
PLANTERS = ((7.4, 5.9), (12.6, 5.2), (8.6, -2.6))


def paving_meshes(random: np.random.Generator) -> tuple[Mesh, ...]:
    """Cobbles with bands of pale slabs, and the ring road around the fountain."""
    cobbles = tile_pixels(
        random,
        [(0.33, 0.30, 0.27), (0.27, 0.26, 0.25), (0.38, 0.34, 0.29), (0.30, 0.27, 0.23)],
        (0.12, 0.11, 0.095),
        (30, 24),
        0.5,
        1024,
        joint_width=0.13,
    )
    stains = 0.72 + 0.45 * noise_pixels(random, 1024, 0.8)
    cobbles[:42] = 0.46 * (0.8 + 0.3 * noise_pixels(random, 1024, 0.2)[:42])  # a row of pale slabs
    cobbles[42:46] = cobbles[:3].min()
    cobbles = cobbles * stains
    plaza = quads((-60, -60, 0), (120, 0, 0), (0, 120, 0), tile_size=6.0)
    asphalt = mix_colours(
        (0.055, 0.055, 0.06), (0.115, 0.11, 0.105), noise_pixels(random, 256, 0.35)
    )
    ring = lathe([(ROAD_RADIUS + 1.6, 0.02), (ROAD_RADIUS - 1.6, 0.02)], 96)
    return (
        plaza.to_mesh("cobbles", diffuse_bsdf(bitmap_texture(cobbles))),
        ring.to_mesh("road", glossy_bsdf(bitmap_texture(asphalt), 0.28)),
    )


def building_meshes(random: np.random.Generator, trees: Sequence[Tree]) -> tuple[Mesh, ...]:
    """Rows of houses, the office tower, and all static parts with the same materials."""
    rows = [
        (
            (-SQUARE_HALF_WIDTH - 2.4, SQUARE_HALF_WIDTH),
            0.0,
            ((4, 4, "stone"), (5, 4, "brick"), (4, 5, "ochre")),
        ),
        ((-27.0, -SQUARE_HALF_WIDTH), np.pi / 2, LOW_HOUSES),
        ((SQUARE_HALF_WIDTH + 2, 6.0), -np.pi / 2, ((4, 4, "stone"), (5, 3, "ochre"))),
    ]
    parts: dict[str, list[Shape]] = {}
    for corner, turn, houses in rows:
        offset = np.zeros(3)
        for bays, storeys, wall in houses:
            for name, shape in build_house(random, bays, storeys).items():
                moved = transform(transform(shape, offset), (*corner, 0), yaw_matrix(turn))
                parts.setdefault(wall if name == "wall" else name, []).append(moved)
            offset = offset + (bays * BAY_WIDTH, 0, 0)
    size = len(HOUSE_COLOURS)
    tower = build_panes(random, *OFFICE_POSITION)
    offices = ATLAS_CELLS * (ATLAS_CELLS - 2) + random.integers(
        ATLAS_CELLS, size=len(tower.vertices) // 4
    )
    parts["glass"].append(show_atlas_cells(tower, offices))
    parts["trim"] += [build_fountain(), build_kerbs(ROAD_RADIUS)]
    parts["paint"] += [
        paint(build_trunks(trees), 4, size),
        street.build_benches(BENCHES, 12, 8, size),
        street.build_cafe_tables(CAFE_TABLES, (5, 6), 12, 8, size),
        street.build_planters(random, PLANTERS, 12, (9, 10, 11, 11, 11), size),
    ]
    grain = noise_pixels(random, 256, 0.6)
    plaster = mix_colours((0.56, 0.36, 0.18), (0.66, 0.48, 0.28), grain)
    brick = tile_pixels(
        random,
        [(0.34, 0.13, 0.08), (0.28, 0.10, 0.07), (0.40, 0.18, 0.11), (0.30, 0.14, 0.10)],
        (0.40, 0.36, 0.31),
        (26, 9),
        0.5,
        512,
        joint_width=0.12,
    )
    ashlar = tile_pixels(
        random,
        [(0.58, 0.54, 0.46), (0.64, 0.59, 0.50)],
        (0.36, 0.33, 0.28),
        (5, 3),
        0.5,
        joint_width=0.04,
    )
    glass_bsdf = {
        "type": "roughplastic",
        "alpha": 0.1,
        "diffuse_reflectance": bitmap_texture(window_atlas(random)),
        "int_ior": 1.8,
    }
    materials = {
        "ochre": diffuse_bsdf(bitmap_texture(plaster)),
        "brick": diffuse_bsdf(bitmap_texture(brick)),
        "stone": diffuse_bsdf(bitmap_texture(ashlar)),
        "trim": diffuse_bsdf(
            bitmap_texture(mix_colours((0.56, 0.52, 0.45), (0.68, 0.64, 0.56), grain))
        ),
        "glass": glass_bsdf,
        "paint": diffuse_bsdf(palette_texture(HOUSE_COLOURS)),
    }
    return (
        *(merge(*parts[name]).to_mesh(name, material) for name, material in materials.items()),
        *_reflective_meshes(),
    )


def _reflective_meshes() -> tuple[Mesh, ...]:
    """Glossy parts: metal, parked cars and the water of the fountain."""
    size = len(METAL_COLOURS)
    metals = merge(
        paint(transform(icosphere(4), (0, 0, 3.25), scale=0.62), 0, size),
        paint(unmerge_vertices(build_frame(*OFFICE_POSITION)), 1, size),
        paint(street.build_lamp_posts(LAMP_POSTS), 2, size),
        paint(street.build_bollards(_bollard_positions()), 2, size),
    )
    parked = merge(
        *(
            transform(build_car(body_colour), (x, y, 0), yaw_matrix(turn))
            for x, y, turn, body_colour in PARKED_CARS
        )
    )
    water = merge(disc(2.85, 0.62, 48), disc(1.3, 1.88, 40))
    water_bsdf = {
        "type": "roughplastic",
        "diffuse_reflectance": rgb(0.03, 0.08, 0.08),
        "int_ior": 1.33,
        "alpha": 0.05,
    }
    return (
        water.to_mesh("pool", water_bsdf),
        metals.to_mesh("metal", metal_bsdf(palette_texture(METAL_COLOURS), 0.18), smooth=True),
        parked.to_mesh("parked", car_paint_bsdf(), smooth=True),
    )


def car_paint_bsdf() -> dict[str, object]:
    """Car paint: a clear coat over palette colours."""
    return glossy_bsdf(palette_texture(CAR_COLOURS), 0.09)


def _bollard_positions() -> tuple[tuple[float, float], ...]:
    angle = np.linspace(-2.5, -0.5, 9)
    return tuple((float(8.6 * np.cos(a)), float(8.6 * np.sin(a))) for a in angle)


def build_kerbs(road_radius: float) -> Shape:
    """Low stone kerbs on both sides of the road."""
    inner, outer = road_radius - 1.6, road_radius + 1.6
    return merge(
        lathe([(outer, 0.0), (outer, 0.1), (outer + 0.14, 0.1), (outer + 0.14, 0.0)][::-1], 96),
        lathe([(inner, 0.0), (inner, 0.1), (inner - 0.14, 0.1), (inner - 0.14, 0.0)], 96),
    )


def build_fountain() -> Shape:
    """The basin, the stem with its bowl, and the base of the golden ball."""
    rim = lathe(
        [(3.1, 0), (3.15, 0.08), (3.05, 0.14), (3.05, 0.5), (3.3, 0.58), (3.3, 0.75), (2.8, 0.75)]
        + [(2.8, 0.2)],
        64,
    )
    stem = lathe(
        [(0.8, 0.1), (0.7, 0.3), (0.35, 0.6), (0.28, 1.2), (0.45, 1.45), (1.3, 1.75), (1.4, 1.95)]
        + [(1.3, 1.95), (0.3, 1.8), (0.22, 2.2), (0.3, 2.55), (0.2, 2.7)],
        40,
    )
    return merge(rim, stem, boxes((-0.2, -0.2, 2.55), (0.2, 0.2, 2.7)))
