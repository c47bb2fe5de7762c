"""Conversion of scenes to Mitsuba objects."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.render.mitsuba import load
from rlbench.render.mitsuba.load import smooth_normals
from rlbench.render.mitsuba.open_tracer import open_tracer
from tests.render.small_scenes import ball, diffuse, room


def test_a_mesh_attribute_as_radiance_is_an_error(variant):
    by_face = {"type": "area", "radiance": {"type": "mesh_attribute", "name": "face_light"}}
    *others, lamp = room().meshes
    scene = replace(room(), meshes=(*others, replace(lamp, emission=by_face)))
    with pytest.raises(load.LightError, match="the radiance of mesh 'lamp' is a mesh attribute"):
        open_tracer(scene, 4, 4)


def test_an_uploaded_array_is_a_copy(llvm):
    import mitsuba as mi

    values = np.arange(64, dtype=np.float32)
    uploaded = load.upload(mi.Float, values)
    values[:] = -1
    assert uploaded.numpy().tolist() == list(range(64))


@pytest.mark.parametrize("length", [16, 1000, 100_000, 1_000_000])
def test_an_uploaded_array_is_aligned(llvm, length):
    import mitsuba as mi

    # otherwise Dr.Jit compiles a kernel for each alignment of each input
    unaligned = np.zeros(length + 1, np.float32)[1:]
    assert load.upload(mi.Float, unaligned).numpy().ctypes.data % 64 == 0


def test_smooth_normals_of_a_sphere_point_outwards():
    mesh = ball()
    normals = smooth_normals(mesh.vertices, mesh.faces)
    # within one ring of faces, 1/48 of a half circle
    assert (normals * mesh.vertices).sum(1).min() > np.cos(np.pi / 48)


def test_smooth_normals_equal_mitsubas(llvm):
    import mitsuba as mi

    random = np.random.default_rng(0)
    mesh = ball()
    vertices = mesh.vertices * random.uniform(0.8, 1.2, mesh.vertices.shape).astype(np.float32)
    shape = mi.Mesh("ball", len(vertices), len(mesh.faces), has_vertex_normals=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(vertices.ravel())
    parameters["faces"] = mi.UInt32(mesh.faces.ravel())
    parameters.update()
    theirs = mi.traverse(shape)["vertex_normals"].numpy().reshape(-1, 3)
    ring = slice(64, -64)  # not the poles, whose faces without area Mitsuba counts too
    ours = smooth_normals(vertices, mesh.faces)
    np.testing.assert_allclose(
        ours[ring], theirs[ring], atol=2e-3
    )  # Mitsuba approximates the arc cosine


@pytest.mark.parametrize("time", [0.0, 2.0])
def test_smooth_meshes_have_the_same_normals_in_every_run(llvm, time):
    mesh = replace(ball(200, 400), material=diffuse(0.5, 0.5, 0.5))
    scene = replace(
        room(),
        meshes=(mesh,),
        vertex_animation=lambda time: {"ball": mesh.vertices + np.float32(time / 10)},
    )

    def normals():
        import mitsuba as mi

        tracer = open_tracer(scene, 4, 4)
        tracer.set_time(time)
        return mi.traverse(tracer.mi_scene)["ball.vertex_normals"].numpy()

    first = normals()
    for _ in range(4):  # Mitsuba's own differ within two or three runs
        np.testing.assert_array_equal(normals(), first)
