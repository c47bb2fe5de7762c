"""Motion vectors in the test scenes: the previous camera's ray hits the same point."""

import numpy as np
import pytest

from rlbench.render.jobs.render_clips import scene_of_clip
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.scene import Pose

SIDE = 192
TIME = 3.0
NEAR = 1e-3  # m, between expected and actual previous position


@pytest.mark.parametrize("name", ["temple", "city", "hall", "ripples"])
def test_motion_leads_to_the_same_point_a_frame_earlier(llvm, name):
    tracer = open_tracer(scene_of_clip(name), SIDE, SIDE)
    rows, columns = np.indices((SIDE, SIDE)).reshape(2, -1)
    film = np.stack([columns, rows], 1) + 0.5
    tracer.set_time(TIME)
    motion = render_gbuffer(tracer, {"motion"})["motion"].reshape(-1, 2)
    mesh, face_uv, hit = query_film(tracer, film)
    directions = tracer.pose.ray_directions(film, SIDE, SIDE)
    tracer.set_time(TIME - 1)
    mesh_then, face_uv_then, hit_then = query_film(tracer, film + motion)
    eye = np.asarray(tracer.pose.camera.origin)

    expected_offset = points(tracer, mesh, face_uv, hit) - eye
    previous_offset = points(tracer, mesh_then, face_uv_then, hit_then) - eye
    same = (
        hit
        & hit_then
        & (mesh == mesh_then)
        & (np.linalg.norm(previous_offset - expected_offset, axis=1) < NEAR)
    )
    apart = abs(directions - tracer.pose.ray_directions(film + motion, SIDE, SIDE)).max(1)
    same |= ~hit & ~hit_then & (apart < 1e-5)  # the sky: a hundredth of a pixel
    far = np.where(hit, np.linalg.norm(expected_offset, axis=1), np.inf)
    hidden = hit_then & (np.linalg.norm(previous_offset, axis=1) < far - NEAR)
    assert same.mean() > 0.9
    assert (~same & ~hidden).mean() < 1e-4


def query_film(tracer, film):
    """For each film position: the mesh, (face, u, v) on it, and whether there is a hit."""

    def query(ray):
        hit = tracer.mi_scene.ray_intersect_preliminary(ray)
        return tracer.mesh_index(hit), hit.prim_index, hit.prim_uv.x, hit.prim_uv.y, hit.t

    mesh, *face_uv, distance = tracer.evaluate_rays(query, film)
    return mesh, np.stack(face_uv, 1), np.isfinite(distance)


def points(tracer, mesh, face_uv, hit):
    """World positions of points on meshes at the tracer's time, by the scene's own animation."""
    positions = np.zeros((len(mesh), 3))
    vertices = Pose.at_time(tracer.scene, tracer.time).vertices
    for number, (shape, corners) in enumerate(zip(tracer.scene.meshes, vertices, strict=True)):
        is_mesh = hit & (mesh == number)
        a, b, c = np.moveaxis(
            corners[shape.faces[face_uv[is_mesh, 0].astype(int)]].astype(float), 1, 0
        )
        positions[is_mesh] = a + face_uv[is_mesh, 1:2] * (b - a) + face_uv[is_mesh, 2:] * (c - a)
    return positions
