"""The G-buffer against closed forms, and motion against the previous camera's rays."""

import numpy as np
import pytest

from rlbench.apps.render.jobs.render_clips import scene_of_clip
from rlbench.apps.render.mitsuba.gbuffer import follow_specular_chain, render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import Camera, Pose, Scene
from rlbench.clips.header import BUFFER_CHANNELS
from tests.apps.render.small_scenes import (
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
    expected = np.broadcast_to(expected, (4, 4, 3))
    np.testing.assert_allclose(plane_albedo(material), expected, atol=error)


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


def test_albedo_looks_through_glass_whose_first_albedo_is_one(variant):
    tracer = open_tracer(room(), H, W)
    gbuffer = render_gbuffer(tracer, {"albedo", "albedo_first"})
    pane = _mesh(tracer) == 3
    assert pane.sum() > 20
    behind = (abs(gbuffer["albedo"][pane] - [0.6, 0.5, 0.4]) < 0.02).all(-1)
    assert behind.mean() > 0.5  # the rest shows the sky, or the pane's edges
    # not scaled by the squared refractive index
    np.testing.assert_allclose(gbuffer["albedo_first"][pane], 1.0, atol=1e-5)


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
    tracer = open_tracer(around_the_corner(material), 8, 8)
    gbuffer = render_gbuffer(tracer, {"albedo", "albedo_first"})
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
    tracer = open_tracer(around_the_corner(diffuse(0.5, 0.5, 0.5)), 5, 5)
    gbuffer = render_gbuffer(tracer, BUFFER_CHANNELS)
    for name in ("normal", "object"):
        np.testing.assert_array_equal(gbuffer[f"{name}_psr"], gbuffer[name])
    np.testing.assert_allclose(gbuffer["depth_psr"], gbuffer["depth"], rtol=1e-5)
    np.testing.assert_array_equal(gbuffer["albedo_first"], gbuffer["albedo"])


def test_objects_are_numbered_as_the_meshes_are(variant):
    tracer = open_tracer(room(), H, W)
    gbuffer = render_gbuffer(tracer, {"object"})
    assert set(gbuffer) == {"object"}  # no buffer that nobody asked for
    np.testing.assert_array_equal(gbuffer["object"][..., 0], _mesh(tracer) + 1)
    assert {0, 1, 2, 3, 4} <= set(gbuffer["object"].ravel())


def test_background_has_no_normal_no_albedo_no_object_and_infinite_depth(variant):
    gbuffer = render_gbuffer(open_tracer(room(), H, W), BUFFER_CHANNELS)
    sky = np.isinf(gbuffer["depth"][..., 0])
    assert 0 < sky.sum() < sky.size
    behind = np.isinf(gbuffer["depth_psr"][..., 0])
    assert (behind & ~sky).sum() > 0  # seen through the pane
    for name in ("normal", "albedo_first", "albedo"):
        assert not gbuffer[name][sky].any()
    assert not gbuffer["normal_psr"][behind].any()
    assert not gbuffer["object_psr"][behind].any()


def test_depth_runs_along_the_view_axis(variant):
    plane = looking_down(diffuse(0.5, 0.5, 0.5), height=3.0)
    depth = render_gbuffer(open_tracer(plane, 8, 8))["depth"]
    np.testing.assert_allclose(depth, 3.0, rtol=1e-6)


def test_normals_are_unit_vectors_towards_the_camera(variant):
    tracer = open_tracer(room(), H, W)
    gbuffer = render_gbuffer(tracer)
    visible = np.isfinite(gbuffer["depth"][..., 0])
    normal = gbuffer["normal"][visible]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-5)
    directions = tracer.pose.ray_directions(_centres(H, W), H, W)[visible.ravel()]
    assert ((normal * directions).sum(1) < 0).all()


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


def test_motion_of_a_mesh_that_deforms_is_exact(variant):
    tracer = open_tracer(stretching(diffuse(0.5, 0.5, 0.5)), 9, 9)
    tracer.set_time(5.0)
    rows, columns = np.indices((9, 9))
    from_middle = np.stack([columns, rows], -1) - 4.0
    # 1.4 times its first size before, 1.5 times now
    expected = from_middle * (1.4 / 1.5 - 1)
    np.testing.assert_allclose(render_gbuffer(tracer)["motion"], expected, atol=1e-4)


def _centres(h, w):
    rows, columns = np.indices((h, w)).reshape(2, -1)
    return np.stack([columns, rows], 1) + 0.5


def _mesh(tracer):
    """The mesh index at each pixel, -1 for background."""
    mesh, _, hit = _query(tracer, _centres(H, W))
    return np.where(hit, mesh.astype(int), -1).reshape(H, W)


def _query(tracer, film):
    """For each film position: the mesh, (face, u, v) on it, and whether there is a hit."""

    def query(ray):
        hit = tracer.mi_scene.ray_intersect_preliminary(ray)
        return tracer.mesh_index(hit), hit.prim_index, hit.prim_uv.x, hit.prim_uv.y, hit.t

    mesh, *face_uv, distance = tracer.evaluate_rays(query, film)
    return mesh, np.stack(face_uv, 1), np.isfinite(distance)


def _offsets(tracer, mesh, face_uv, hit):
    """From the camera to points on meshes at the tracer's time, by the scene's own animation."""
    positions = np.zeros((len(mesh), 3))
    vertices = Pose.at_time(tracer.scene, tracer.time).vertices
    for number, (shape, corners) in enumerate(zip(tracer.scene.meshes, vertices, strict=True)):
        at = hit & (mesh == number)
        faces = shape.faces[face_uv[at, 0].astype(int)]
        a, b, c = np.moveaxis(corners[faces].astype(float), 1, 0)
        positions[at] = a + face_uv[at, 1:2] * (b - a) + face_uv[at, 2:] * (c - a)
    return positions - np.asarray(tracer.pose.camera.origin)


@pytest.mark.parametrize(
    ("name", "variant", "visible"),
    [
        ("room", "llvm_ad_rgb", 0.75),
        ("room", "scalar_rgb", 0.75),
        ("temple", "llvm_ad_rgb", 0.9),
        ("ripples", "llvm_ad_rgb", 0.9),
        *(
            pytest.param(name, "llvm_ad_rgb", 0.9, marks=pytest.mark.slow)
            for name in ("city", "hall")
        ),
    ],
    indirect=["variant"],
)
def test_motion_leads_to_the_same_point_a_frame_earlier(name, variant, visible):
    scene, side = (room(), H) if name == "room" else (scene_of_clip(name), SIDE)
    tracer = open_tracer(scene, side, side)
    film = _centres(side, side)
    tracer.set_time(TIME)
    motion = render_gbuffer(tracer, {"motion"})["motion"].reshape(-1, 2)
    mesh, face_uv, hit = _query(tracer, film)
    directions = tracer.pose.ray_directions(film, side, side)
    tracer.set_time(TIME - 1)
    mesh_then, face_uv_then, hit_then = _query(tracer, film + motion)

    expected = _offsets(tracer, mesh, face_uv, hit)
    previous = _offsets(tracer, mesh_then, face_uv_then, hit_then)
    near = np.linalg.norm(previous - expected, axis=1) < NEAR
    same = hit & hit_then & (mesh == mesh_then) & near
    apart = abs(directions - tracer.pose.ray_directions(film + motion, side, side)).max(1)
    same |= ~hit & ~hit_then & (apart < 1e-5)  # the sky: a hundredth of a pixel
    far = np.where(hit, np.linalg.norm(expected, axis=1), np.inf)
    hidden = hit_then & (np.linalg.norm(previous, axis=1) < far - NEAR)
    assert same.mean() > visible
    assert (~same & ~hidden).mean() < 1e-4
