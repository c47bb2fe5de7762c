"""Loading a scene, and animating its vertices and lights."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.apps.render.mitsuba import load
from rlbench.apps.render.mitsuba.load import LightError, smooth_normals
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from tests.apps.render.conftest import check_no_kernel_is_compiled
from tests.apps.render.small_scenes import ball, diffuse, grey, room

H, W, SPP = 12, 16, 16
CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
TEXELS = np.random.default_rng(0).uniform(0, 30, (4, 4, 3)).astype(np.float32)


@pytest.mark.parametrize("length", [16, 1000, 100_000, 1_000_000])
def test_an_uploaded_array_is_an_aligned_copy(llvm, length):
    import mitsuba as mi

    # otherwise Dr.Jit compiles a kernel for each alignment of each input
    unaligned = np.arange(length + 1, dtype=np.float32)[1:]
    uploaded = load.upload(mi.Float, unaligned).numpy()
    assert uploaded.ctypes.data % 64 == 0
    unaligned[:] = -1
    assert uploaded.tolist() == list(range(1, length + 1))


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
    # Mitsuba approximates the arc cosine
    np.testing.assert_allclose(ours[ring], theirs[ring], atol=2e-3)


@pytest.mark.parametrize("time", [pytest.param(0.0, marks=pytest.mark.slow), 2.0])
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


def bitmap(factor):
    texels = {"type": "bitmap", "raw": True, "filter_type": "nearest", "data": TEXELS * factor}
    return {"type": "area", "radiance": texels}


def with_lamp(emission):
    *others, lamp = room().meshes
    return replace(room(), meshes=(*others, replace(lamp, emission=emission, uv=CORNERS)))


def with_sky(**sky):
    return replace(room(), sky=(sky,))


def with_factor(light, factor):
    return replace(room(), lights=lambda time: {light: factor})


def sun(factor):
    return {"type": "directional", "direction": [0.1, 0.3, -1], "irradiance": grey(2 * factor)}


SUNSKY = {"type": "sunsky", "turbidity": 3.5, "sun_direction": [-0.6, -0.4, 0.7]}
LIGHT_CASES = {  # the scaled light, and a function from its factor to the room
    "lamp": ("lamp", lambda f: with_lamp({"type": "area", "radiance": grey(12 * f)})),
    "bitmap": ("lamp", lambda f: with_lamp(bitmap(f))),
    "constant": ("sky0", lambda f: with_sky(type="constant", radiance=grey(0.3 * f))),
    "sun": ("sky1", lambda f: replace(room(), sky=(*room().sky, sun(f)))),
    "sunsky": ("sky0", lambda f: with_sky(**SUNSKY, sun_scale=f, sky_scale=f)),
}


def switched(scene, light, at=5):
    """The scene with a light scaled to a quarter in frames `at` and `at` + 1, then to 0."""
    shares = {at: 0.25, at + 1: 0.25}
    return replace(scene, lights=lambda time: {light: shares.get(time, 0.0)} if time >= at else {})


@pytest.mark.parametrize("share", [0.25, 0.0])
@pytest.mark.parametrize("kind", LIGHT_CASES)
def test_a_scaled_light_equals_one_loaded_with_that_strength(llvm, kind, share):
    light, build = LIGHT_CASES[kind]
    scenes = switched(build(1.0), light), build(share)
    changing, fresh = (open_tracer(scene, H, W) for scene in scenes)
    full = changing.trace_images(SPP)
    changing.set_time(5.0 if share else 7.0)
    fresh.set_time(changing.time)
    dimmed, expected = changing.trace_images(SPP), fresh.trace_images(SPP)
    assert dimmed.mean() < 0.98 * full.mean()
    # the same paths; a table of the emitter may be rounded differently, so a few texels differ
    assert dimmed.mean() == pytest.approx(expected.mean(), rel=2e-3)
    assert np.isclose(dimmed, expected, rtol=1e-4, atol=1e-6).mean() > 0.99


@pytest.mark.parametrize("kind", ["lamp", "bitmap"])
def test_without_llvm_lights_are_scaled_too(kind):
    select_variant("scalar_rgb")
    light, build = LIGHT_CASES[kind]
    tracer, fresh = open_tracer(switched(build(1.0), light), 4, 6), open_tracer(build(0.25), 4, 6)
    for each in (tracer, fresh):
        each.set_time(5.0)
    # the same paths, and float32 all along
    assert tracer.trace_images(4).mean() == pytest.approx(fresh.trace_images(4).mean(), rel=1e-4)
    tracer.set_time(7.0)
    assert np.isfinite(tracer.trace_images(4)).all()


def test_a_light_returns_to_its_full_strength(llvm):
    tracer = open_tracer(switched(room(), "lamp"), H, W)
    tracer.set_time(1.0)
    before = tracer.trace_images(2)
    for time in (7.0, 5.0, 1.0):
        tracer.set_time(time)
    np.testing.assert_array_equal(tracer.trace_images(2), before)


@pytest.mark.parametrize("kind", ["lamp", "bitmap", "constant", "sun"])
def test_scaling_a_light_again_compiles_no_kernel(llvm, kind):
    light, build = LIGHT_CASES[kind]
    tracer = open_tracer(replace(build(1.0), lights=lambda time: {light: 1 / (1 + time)}), H, W)

    def trace(*times):
        for time in times:
            tracer.set_time(time)
            tracer.trace_images(1)

    trace(1.0, 2.0)
    check_no_kernel_is_compiled(lambda: trace(3.0, 4.5, 7.0))


BY_FACE = {"type": "area", "radiance": {"type": "mesh_attribute", "name": "face_light"}}


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (with_lamp(BY_FACE), "the radiance of mesh 'lamp' is a mesh attribute"),
        (with_factor("moon", 0.5), "no light 'moon' whose strength .* available: lamp, sky0"),
        (with_factor("lamp", -1.0), "scaled by -1.0; factors must be finite and at least 0"),
        (with_factor("lamp", float("nan")), "light 'lamp' is scaled by nan"),
    ],
)
def test_an_invalid_light_is_an_error(variant, scene, message):
    with pytest.raises(LightError, match=message):
        open_tracer(scene, H, W)
