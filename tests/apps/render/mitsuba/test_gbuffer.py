"""The G-buffer against closed forms, and motion against the previous camera's rays."""

import numpy as np
import pytest

from rlbench.apps.render.jobs.render_clips import scene_of_clip
from rlbench.apps.render.mitsuba.gbuffer import follow_specular_chain, render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import Camera, Pose, Scene
from rlbench.clips.header import BUFFER_CHANNELS
from tests.apps.render.small_scenes import (
    STEP,
    around_the_corner,
    diffuse,
    grey,
    looking_down,
    room,
    stretching,
)

H, W = 48, 64
MIRROR = {"type": "conductor", "material": "none", "specular_reflectance": grey(0.6)}
ROUGH = {**MIRROR, "type": "roughconductor", "alpha": 0.05}
SIDE = 192
TIME = 3.0
NEAR = 1e-3  # m, between expected and actual previous position


def plane_albedo(material):
    return render_gbuffer(open_tracer(looking_down(material, fov=1.0), 4, 4), {"albedo"})["albedo"]


@pytest.mark.parametrize(
    ("material", "expected", "error"),
    [
        (diffuse(0.6, 0.5, 0.4), (0.6, 0.5, 0.4), 1e-6),
        (MIRROR, (0.6, 0.6, 0.6), 1e-6),
        (ROUGH, (0.6, 0.6, 0.6), 5e-3),  # a smooth rough mirror loses next to nothing
    ],
    ids=["diffuse", "mirror", "rough mirror"],
)
def test_albedo_of_known_materials(variant, material, expected, error):
    np.testing.assert_allclose(
        plane_albedo(material), np.broadcast_to(expected, (4, 4, 3)), atol=error
    )


@pytest.mark.parametrize(
    "material",
    [
        {"type": "roughconductor", "alpha": 0.2, "material": "Au"},
        {"type": "roughplastic", "diffuse_reflectance": grey(0.6)},
        {"type": "principled", "base_color": grey(0.6), "roughness": 0.4},
        {"type": "blendbsdf", "weight": 0.5, "a": diffuse(0.6, 0.6, 0.6), "b": {**ROUGH}},
        {"type": "mask", "opacity": 0.5, "a": diffuse(0.6, 0.6, 0.6)},
        {"type": "twosided", "a": {"type": "roughplastic", "alpha": 0.3}},
        {"type": "roughdielectric", "alpha": 0.3},
    ],
    ids=lambda material: material["type"],
)
def test_albedo_is_the_hemispherical_reflectance(llvm, material):
    import drjit as dr
    import mitsuba as mi

    lanes = 65_536
    surface = dr.zeros(mi.SurfaceInteraction3f, lanes)
    surface.wi = mi.Vector3f(0, 0, 1)
    source = mi.load_dict({"type": "independent"})
    source.seed(1, lanes)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    _, weight = mi.load_dict(material).sample(context, surface, source.next_1d(), source.next_2d())
    truth = [weight[c].numpy().mean() for c in range(3)]
    # 16 points against 65 thousand: the quadrature errs by up to 0.035 over all angles
    np.testing.assert_allclose(plane_albedo(material)[2, 2], truth, atol=0.04)


def test_albedo_looks_through_glass(variant):
    tracer = open_tracer(room(), H, W)
    gbuffer = render_gbuffer(tracer, {"albedo"})["albedo"]
    rows, columns = np.nonzero(_mesh(tracer) == 3)
    assert len(rows) > 20
    behind = (abs(gbuffer[rows, columns] - [0.6, 0.5, 0.4]) < 0.02).all(-1)
    assert behind.mean() > 0.5  # the rest shows the sky, or the pane's edges


@pytest.mark.parametrize(
    "material",
    [
        {"type": "roughconductor", "alpha": 0.05, "material": "Au"},
        {"type": "dielectric"},
        {"type": "thindielectric"},
        {"type": "roughdielectric", "alpha": 0.3},
        {"type": "null"},
        {"type": "principled", "base_color": grey(1.0), "metallic": 1.0, "roughness": 0.1},
    ],
    ids=lambda material: material["type"],
)
def test_albedo_is_between_zero_and_one_and_no_surface_is_black(llvm, material):
    gbuffer = render_gbuffer(
        open_tracer(around_the_corner(material), 8, 8), {"albedo", "albedo_first"}
    )
    for albedo in gbuffer.values():
        assert albedo.min() > 0.05  # the wall behind clear materials has a red albedo of 0.2
        assert albedo.max() <= 1


def test_buffers_behind_a_mirror_belong_to_the_reflected_surface(variant):
    gbuffer = render_gbuffer(open_tracer(around_the_corner(MIRROR), 5, 5), BUFFER_CHANNELS)
    middle = {name: buffer[2, 2] for name, buffer in gbuffer.items()}
    assert middle["depth"] == pytest.approx(4.0, rel=1e-5)
    # Mitsuba starts a reflected ray a little off the mirror
    assert middle["depth_psr"] == pytest.approx(4.0 + 3.0, rel=1e-4)
    np.testing.assert_allclose(middle["normal"], [0.5**0.5, -(0.5**0.5), 0], atol=1e-5)
    np.testing.assert_allclose(middle["normal_psr"], [-1, 0, 0], atol=1e-5)
    np.testing.assert_allclose(middle["albedo_first"], [0.6] * 3, atol=1e-5)
    np.testing.assert_allclose(middle["albedo"], np.multiply(0.6, [0.2, 0.4, 0.8]), atol=1e-5)
    assert (middle["object"], middle["object_psr"]) == (1, 2)


def test_buffers_behind_a_rough_surface_belong_to_that_surface(variant):
    gbuffer = render_gbuffer(
        open_tracer(around_the_corner(diffuse(0.5, 0.5, 0.5)), 5, 5), BUFFER_CHANNELS
    )
    for name in ("normal", "object"):
        np.testing.assert_array_equal(gbuffer[f"{name}_psr"], gbuffer[name])
    np.testing.assert_allclose(gbuffer["depth_psr"], gbuffer["depth"], rtol=1e-5)
    np.testing.assert_array_equal(gbuffer["albedo_first"], gbuffer["albedo"])


def test_objects_are_numbered_as_the_meshes_are(variant):
    tracer = open_tracer(room(), H, W)
    gbuffer = render_gbuffer(tracer, {"object"})["object"][..., 0]
    np.testing.assert_array_equal(gbuffer, _mesh(tracer) + 1)
    assert {0, 1, 2, 3, 4} <= set(gbuffer.ravel())


def test_the_first_albedo_of_glass_is_one(variant):
    tracer = open_tracer(room(), H, W)
    pane = render_gbuffer(tracer, {"albedo_first"})["albedo_first"][_mesh(tracer) == 3]
    np.testing.assert_allclose(pane, 1.0, atol=1e-5)  # not scaled by the squared refractive index


def test_background_behind_is_background(variant):
    tracer = open_tracer(room(), H, W)
    gbuffer = render_gbuffer(tracer, BUFFER_CHANNELS)
    sky = np.isinf(gbuffer["depth_psr"][..., 0])
    assert (sky & np.isfinite(gbuffer["depth"][..., 0])).sum() > 0  # seen through the pane
    assert not gbuffer["normal_psr"][sky].any()
    assert not gbuffer["object_psr"][sky].any()


def test_depth_runs_along_the_view_axis(variant):
    depth = render_gbuffer(open_tracer(looking_down(diffuse(0.5, 0.5, 0.5), height=3.0), 8, 8))[
        "depth"
    ]
    np.testing.assert_allclose(depth, 3.0, rtol=1e-6)


def test_background_has_no_normal_no_albedo_and_infinite_depth(variant):
    gbuffer = render_gbuffer(open_tracer(room(), H, W), BUFFER_CHANNELS)
    sky = np.isinf(gbuffer["depth"][..., 0])
    assert 0 < sky.sum() < sky.size
    assert not gbuffer["normal"][sky].any()
    assert not gbuffer["albedo_first"][sky].any()
    assert not gbuffer["albedo"][sky].any()


def test_normals_are_unit_vectors_towards_the_camera(variant):
    tracer = open_tracer(room(), H, W)
    gbuffer = render_gbuffer(tracer)
    visible = np.isfinite(gbuffer["depth"][..., 0])
    normal = gbuffer["normal"][visible]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-5)
    directions = tracer.pose.ray_directions(_centres(), H, W)[visible.ravel()]
    assert ((normal * directions).sum(1) < 0).all()


def test_only_requested_buffers_are_returned(variant):
    assert set(render_gbuffer(open_tracer(room(), 4, 4), {"depth", "normal"})) == {
        "depth",
        "normal",
    }


def test_no_ray_follows_mirrors_for_buffers_of_the_first_surface(variant, monkeypatch):
    calls = []
    monkeypatch.setattr(
        "rlbench.apps.render.mitsuba.gbuffer.follow_specular_chain",
        lambda *rays: calls.append(rays) or follow_specular_chain(*rays),
    )
    tracer = open_tracer(room(), 4, 4)
    render_gbuffer(tracer, {"normal", "depth"})
    assert not calls
    render_gbuffer(tracer, {"albedo"})  # of what glass and mirrors show
    assert calls


def test_a_static_scene_has_no_motion(variant):
    assert not render_gbuffer(open_tracer(room(static=True), H, W))["motion"].any()


def test_the_sky_moves_with_the_turning_camera(llvm):
    def camera(time):
        angle = 0.01 * time  # radians to the left per frame, seen from above
        return Camera((0, 0, 0), (-np.sin(angle), np.cos(angle), 0), fov=60.0)

    sky = ({"type": "constant", "radiance": grey(1.0)},)
    ground = looking_down(diffuse(0.5, 0.5, 0.5)).meshes[0]
    below = ground.vertices - np.float32([0, 0, 5])
    scene = Scene("sky", "", (ground,), camera, sky, vertex_animation=lambda time: {"plane": below})
    tracer = open_tracer(scene, 3, 65)
    motion = render_gbuffer(tracer)["motion"][0, 32]
    # the point ahead was further left in the previous frame, when the camera looked to the right
    pixels = np.tan(0.01) / (np.tan(np.radians(30)) / 32.5)
    np.testing.assert_allclose(motion[0], -pixels, rtol=1e-4)


def test_motion_leads_to_the_same_point_in_the_previous_frame(variant):
    tracer = open_tracer(room(), H, W)
    tracer.set_time(3.0)
    motion = render_gbuffer(tracer)["motion"].reshape(-1, 2)
    mesh = _mesh(tracer).ravel()
    hit = mesh >= 0
    now = _positions(tracer, _centres())
    expected = now - np.where(mesh[:, None] == 1, STEP, 0.0)  # only the cube moved
    tracer.set_time(2.0)
    gbuffer = _positions(tracer, _centres() + motion)
    eye = np.asarray(tracer.pose.camera.origin)
    distances = np.linalg.norm(gbuffer - expected, axis=1)
    nearer = np.linalg.norm(gbuffer - eye, axis=1) < np.linalg.norm(expected - eye, axis=1) - 1e-3
    unexplained = hit & ~(distances < 1e-3) & ~nearer  # 1 mm in a room of 10 m
    assert hit.mean() > 0.5
    assert (nearer & hit).mean() < 0.2
    assert unexplained.mean() < 1e-4


def test_motion_of_a_mesh_that_deforms_is_exact(variant):
    tracer = open_tracer(stretching(diffuse(0.5, 0.5, 0.5)), 9, 9)
    tracer.set_time(5.0)
    rows, columns = np.indices((9, 9))
    from_middle = np.stack([columns, rows], -1) - 4.0
    # 1.4 times its first size before, 1.5 times now
    expected = from_middle * (1.4 / 1.5 - 1)
    np.testing.assert_allclose(render_gbuffer(tracer)["motion"], expected, atol=1e-4)


def _centres():
    rows, columns = np.indices((H, W)).reshape(2, -1)
    return np.stack([columns, rows], 1) + 0.5


def _mesh(tracer):
    """The mesh index at each pixel, -1 for background."""

    def query(ray):
        hit = tracer.mi_scene.ray_intersect_preliminary(ray)
        return tracer.mesh_index(hit), hit.t

    mesh, distance = tracer.evaluate_rays(query, _centres())
    return np.where(np.isfinite(distance), mesh.astype(int), -1).reshape(H, W)


def _positions(tracer, film):
    """World positions of the surfaces at film positions."""

    def query(ray):
        return (tracer.mi_scene.ray_intersect_preliminary(ray).t,)

    (distance,) = tracer.evaluate_rays(query, film)
    eye = np.asarray(tracer.pose.camera.origin)
    distance = np.where(np.isfinite(distance), distance, 1e6).astype(np.float64)
    return eye + distance[:, None] * tracer.pose.ray_directions(film, H, W)


@pytest.mark.parametrize(
    "name",
    ["temple", *(pytest.param(n, marks=pytest.mark.slow) for n in ("city", "hall")), "ripples"],
)
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
