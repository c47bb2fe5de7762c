"""Shapes that scenes are built of: they face outward, are closed, and stand where they should."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.apps.render.scenes.city import houses, square, street, trees
from rlbench.apps.render.scenes.city import scene as city
from rlbench.apps.render.scenes.parts import glassware, shapes
from rlbench.apps.render.scenes.ripples import bath, lilies
from rlbench.apps.render.scenes.ripples import scene as ripples


def normals(shape):
    """The normal of each face, twice the area long."""
    a, b, c = np.moveaxis(shape.vertices[shape.faces].astype(np.float64), 1, 0)
    return np.cross(b - a, c - a)


def centres(shape):
    return shape.vertices[shape.faces].astype(np.float64).mean(1)


def volume(shape):
    """Volume that the faces enclose, by the divergence theorem; negative if inside out."""
    a, b, c = np.moveaxis(shape.vertices[shape.faces].astype(np.float64), 1, 0)
    return (a * np.cross(b, c)).sum() / 6


# shapes


@pytest.mark.parametrize(
    ("shape", "expected", "rel"),
    [
        (shapes.boxes((0, 0, 0), (1, 2, 3)), 6.0, 1e-6),
        (shapes.boxes([(0, 0, 0), (5, 5, 5)], [(1, 1, 1), (7, 6, 6)]), 3.0, 1e-6),
        (shapes.icosphere(4), 4 / 3 * np.pi, 0.01),  # the facets lie inside the ball
        (shapes.cylinder(0.5, 1.0, 3.0, 64), np.pi / 2, 0.01),
    ],
    ids=["box", "two boxes", "ball", "cylinder"],
)
def test_closed_shapes_face_outside_and_enclose_their_volume(shape, expected, rel):
    assert volume(shape) == pytest.approx(expected, rel=rel)


def test_a_quad_faces_along_across_x_up():
    assert np.allclose(normals(shapes.quads((0, 0, 0), (2, 0, 0), (0, 3, 0))), (0, 0, 6))


def test_merge_keeps_every_triangle_where_it_was():
    parts = [shapes.icosphere(1), shapes.transform(shapes.icosphere(0), (3, 0, 0), scale=2.0)]
    merged = shapes.merge(*parts)
    apart = np.concatenate([part.vertices[part.faces] for part in parts])
    assert np.array_equal(merged.vertices[merged.faces], apart)


def test_yaw_by_90_degrees_takes_x_to_y():
    assert np.allclose(shapes.yaw_matrix(np.pi / 2) @ (1, 0, 0), (0, 1, 0), atol=1e-6)


def test_paint_maps_to_the_middle_of_a_texel():
    assert np.allclose(shapes.paint(shapes.icosphere(0), 2, 8).uv, (2.5 / 8, 0.5))


# glassware

GLASS = {
    "vase": glassware.build_vase(),
    "crystal": glassware.build_crystal(),
    "all": glassware.build_glass_on_plinths(bath.PLINTHS),
}


@pytest.mark.parametrize("name", GLASS)
def test_glass_faces_outside_and_is_closed(name):
    """A path that enters through a hole would take air for glass from there on."""
    shape = GLASS[name]
    _, welded = np.unique(shape.vertices.round(5), axis=0, return_inverse=True)
    faces = welded.reshape(-1)[shape.faces]
    edges = np.concatenate([faces, np.roll(faces, -1, 1)], 1).reshape(-1, 2, 3).swapaxes(1, 2)
    edges = edges.reshape(-1, 2)
    assert np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    assert volume(shape) > 0


def test_a_vase_is_hollow():
    solid = np.pi * 0.24**2 * 0.75  # about its outside
    assert 0.03 * solid < volume(GLASS["vase"]) < 0.4 * solid


def test_glass_stands_clear_of_water_and_stone():
    shape = GLASS["all"]
    for x, y, radius, top in bath.PLINTHS:
        near = np.hypot(shape.vertices[:, 0] - x, shape.vertices[:, 1] - y) < 0.9 * radius
        assert 0 < shape.vertices[near, 2].min() - top < 0.06


# the city


def test_cars_stand_on_their_wheels():
    assert abs(street.build_car(0).vertices[:, 2].min()) < 0.01  # metres


@pytest.mark.parametrize("coat", range(4))
def test_cars_are_as_wide_left_as_right(coat):
    y = street.build_car(coat).vertices[:, 1]
    assert y.max() == pytest.approx(-y.min(), abs=0.02)


def test_the_hull_of_a_car_faces_outside():
    for part in street._build_hull(0)[:2]:  # what is not lids and floor
        outward = (normals(part) * (centres(part) - (0, 0, 0.6))).sum(-1)
        assert (outward > 0).mean() > 0.95  # bonnet and arches bend inward here and there


def test_a_pane_of_the_tower_faces_outside_and_shows_one_cell_of_the_atlas():
    panes, side = houses.build_panes(np.random.default_rng(0), 0.0, 0.0), houses.ATLAS_CELLS
    assert ((normals(panes) * centres(panes))[:, :2].sum(-1) > 0).all()
    cells = np.arange(len(panes.vertices) // 4) % side**2
    uv = np.floor(houses.show_atlas_cells(panes, cells).uv.reshape(-1, 4, 2) * side)
    assert (uv == np.stack([cells % side, cells // side], -1)[:, None]).all()


THINGS = {
    "tree": [(tree.x, tree.y) for tree in city.TREES],
    "post": square.LAMP_POSTS,
    "table": square.CAFE_TABLES,
    "parked": [place[:2] for place in square.PARKED_CARS],
    "bench": [place[:2] for place in square.BENCHES],
    "planter": square.PLANTERS,
}


@pytest.mark.parametrize("kind", THINGS)
def test_nothing_stands_in_the_road(kind):
    away = np.linalg.norm(np.array(THINGS[kind], float), axis=1)
    assert (np.abs(away - square.ROAD_RADIUS) > 1.6).all()  # half the road, metres


def test_leaves_keep_to_their_tree_and_off_the_ground():
    tree = trees.Tree(3.0, -2.0)
    shape = trees.build_leaves([tree], 6)
    assert len(shape.faces) == 2 * tree.leaf_count
    away = np.hypot(shape.vertices[:, 0] - tree.x, shape.vertices[:, 1] - tree.y)
    assert away.max() < 2 * tree.crown_radius
    assert 1.2 < shape.vertices[:, 2].min() < shape.vertices[:, 2].max() < 1.3 * tree.height


# the bath


@pytest.mark.parametrize("time", [0.0, 4.0, 8.0, 20.0, 32.0, 65.0, 95.0, 1000.0])
def test_lily_pads_lie_on_the_water_and_not_in_it(time):
    pads = lilies.build_floating(ripples._water_height, time).vertices[
        : len(lilies._build_pads().vertices)
    ]
    sheet = next(mesh for mesh in ripples._moving_meshes(time) if mesh.name == "water").vertices
    side = round(len(sheet) ** 0.5)
    width = 2 * bath.POOL_HALF_WIDTH + 0.1
    cell = np.floor((pads[:, :2] + width / 2) / width * (side - 1)).astype(int)
    level = sheet[:, 2].reshape(side, side)
    corners = [level[cell[:, 1] + j, cell[:, 0] + i] for i in (0, 1) for j in (0, 1)]
    assert (pads[:, 2] > np.min(corners, 0)).all()
    height = pads[:, 2] - np.mean(corners, 0)
    assert (height > 0).all()
    assert (height < 0.05).all()
