"""City and ripples hold together: glass is closed, nothing stands in the way, lilies float."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest

from rlbench.scenes.city import car, office, square, trees
from rlbench.scenes.city import scene as city
from rlbench.scenes.city.windows import ATLAS_CELLS, show_atlas_cells
from rlbench.scenes.parts import glassware
from rlbench.scenes.parts.primitives import icosphere
from rlbench.scenes.ripples import bath, lilies
from rlbench.scenes.ripples import scene as ripples

PATH = (0.0, 4.0, 8.0, 20.0, 32.0, 65.0, 95.0, 1000.0)


@pytest.fixture(scope="module", params=("city", "ripples"))
def scene(request):
    return import_module(f"rlbench.scenes.{request.param}.scene").scene()


def _gap(point, corners):
    """Distance from a point to the nearest of triangles [f 3 3]: to faces or else to edges."""
    corners = corners.astype(np.float64) - point
    ahead = np.roll(corners, -1, 1) - corners  # f 3 3: edges
    share = -(corners * ahead).sum(-1) / (ahead**2).sum(-1)
    edge = np.linalg.norm(corners + share.clip(0, 1)[..., None] * ahead, axis=-1).min(1)
    normal = np.cross(ahead[:, 0], ahead[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    away = (corners[:, 0] * normal).sum(-1)
    foot = away[:, None] * normal  # of the perpendicular, in each plane
    turned = (np.cross(ahead, foot[:, None] - corners) * normal[:, None]).sum(-1)
    return np.where((turned >= 0).all(1), np.abs(away), edge).min()


def test_the_gap_to_a_ball_is_the_distance_to_its_surface():
    sphere = icosphere(4)
    corners = sphere.vertices[sphere.faces]
    assert _gap(np.array([0.3, 0.0, 2.0]), corners) == pytest.approx(np.hypot(0.3, 2) - 1, abs=3e-3)


@pytest.mark.parametrize("time", PATH)
def test_the_camera_keeps_clear_of_every_surface(scene, time):
    origin, moved = np.array(scene.camera(time).origin), scene.moving(time)
    gaps = {m.name: _gap(origin, moved.get(m.name, m.vertices)[m.faces]) for m in scene.meshes}
    assert min(gaps.values()) > 0.5, gaps  # metres


def test_triangles_stay_as_few_as_a_frame_can_afford_to_move(scene):
    assert sum(len(mesh.faces) for mesh in scene.meshes) < 200_000
    moving = scene.moving(0.0)
    assert sum(len(vertices) for vertices in moving.values()) < 120_000


def _edges(shape):
    """How often each edge of a shape occurs, in each direction, after corners are welded."""
    _, same = np.unique(shape.vertices.round(5), axis=0, return_inverse=True)
    faces = same.reshape(-1)[shape.faces]
    ahead = np.concatenate([faces, np.roll(faces, -1, 1)], 1).reshape(-1, 2, 3).swapaxes(1, 2)
    return ahead.reshape(-1, 2)


def _volume(shape):
    a, b, c = np.moveaxis(shape.vertices[shape.faces].astype(np.float64), 1, 0)
    return (a * np.cross(b, c)).sum() / 6  # the divergence theorem


GLASS = {
    "vase": glassware.build_vase(),
    "crystal": glassware.build_crystal(),
    "all": glassware.build_glass_on_plinths(bath.PLINTHS),
}


@pytest.mark.parametrize("name", GLASS)
def test_glass_is_closed(name):
    # a path that enters through a hole would take air for glass from there on
    edges = _edges(GLASS[name])
    there = np.unique(edges, axis=0)
    back = np.unique(edges[:, ::-1], axis=0)
    assert np.array_equal(there, back)


@pytest.mark.parametrize("name", GLASS)
def test_glass_faces_outside(name):
    assert _volume(GLASS[name]) > 0


def test_a_vase_is_hollow():
    solid = np.pi * 0.24**2 * 0.75  # about its outside
    assert 0.03 * solid < _volume(glassware.build_vase()) < 0.4 * solid


def test_glass_stands_clear_of_water_and_stone():
    shape = GLASS["all"]
    low = [
        shape.vertices[np.hypot(shape.vertices[:, 0] - x, shape.vertices[:, 1] - y) < 0.9 * r, 2]
        for x, y, r, top in bath.PLINTHS
    ]
    gaps = [float(z.min() - plinth[3]) for z, plinth in zip(low, bath.PLINTHS, strict=True)]
    assert all(0 < gap < 0.06 for gap in gaps), gaps


@pytest.mark.parametrize("time", PATH)
def test_pads_lie_on_the_water_and_not_in_it(time):
    pads = lilies.build_floating(ripples._water_height, time).vertices[
        : len(lilies._build_pads().vertices)
    ]
    sheet = next(mesh for mesh in ripples._moving_meshes(time) if mesh.name == "water").vertices
    side = round(len(sheet) ** 0.5)
    width = 2 * bath.POOL_HALF_WIDTH + 0.1
    place = (pads[:, :2] + width / 2) / width * (side - 1)  # in cells
    cell = np.floor(place).astype(int)
    level = sheet[:, 2].reshape(side, side)
    corners = [level[cell[:, 1] + j, cell[:, 0] + i] for i in (0, 1) for j in (0, 1)]
    assert (pads[:, 2] > np.min(corners, 0)).all()
    assert (pads[:, 2] - np.mean(corners, 0) > 0).all()
    assert (pads[:, 2] - np.mean(corners, 0) < 0.05).all()


def test_cars_stand_on_their_wheels():
    assert abs(car.build_car(0).vertices[:, 2].min()) < 0.01  # metres


@pytest.mark.parametrize("coat", range(4))
def test_cars_are_as_wide_left_as_right(coat):
    y = car.build_car(coat).vertices[:, 1]
    assert y.max() == pytest.approx(-y.min(), abs=0.02)


def test_the_hull_of_a_car_faces_outside():
    hull = car._build_hull(0)[:2]  # what is not lids and floor
    for part in hull:
        a, b, c = np.moveaxis(part.vertices[part.faces].astype(np.float64), 1, 0)
        outward = (np.cross(b - a, c - a) * ((a + b + c) / 3 - (0, 0, 0.6))).sum(-1)
        assert (outward > 0).mean() > 0.95  # bonnet and arches bend inward here and there


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


def test_a_pane_shows_one_cell_of_the_atlas():
    panes = office.build_panes(np.random.default_rng(0), 0.0, 0.0)
    cells = np.arange(len(panes.vertices) // 4) % ATLAS_CELLS**2
    uv = show_atlas_cells(panes, cells).uv.reshape(-1, 4, 2) * ATLAS_CELLS
    assert np.array_equal(np.floor(uv[..., 0]), (cells % ATLAS_CELLS)[:, None] * np.ones(4))
    assert np.array_equal(np.floor(uv[..., 1]), (cells // ATLAS_CELLS)[:, None] * np.ones(4))


def test_panes_face_away_from_the_tower():
    panes = office.build_panes(np.random.default_rng(0), 0.0, 0.0)
    a, b, c = np.moveaxis(panes.vertices[panes.faces].astype(np.float64), 1, 0)
    assert ((np.cross(b - a, c - a)[:, :2] * (a + b + c)[:, :2]).sum(-1) > 0).all()
