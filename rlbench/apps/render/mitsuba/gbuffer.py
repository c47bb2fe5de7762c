"""The G-buffer: auxiliary features without light transport: albedo, normal, depth, exact motion.

All are evaluated at pixel centres. Normal, depth and motion belong to the first surface, glass
included, so that they agree with each other; albedo looks through glass and mirrors, and is the
BSDF's directional-hemispherical reflectance there. Optional buffers hold the object that is hit,
the first surface's own albedo, and the surface seen through glass and mirrors (primary surface
replacement).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.apps.render.scene import Pose
from rlbench.clips.header import BUFFER_CHANNELS
from rlbench.frames import BUFFERS

CUT_MOTION = -2.0  # motion at a cut, in image sizes along both axes: leads every pixel outside
HIT = {"hit": 1, "mesh": 1, "face": 1, "u": 1, "v": 1, "normal": 3}  # channels of the first hit
BEHIND = {"hit_psr": 1, "mesh_psr": 1, "normal_psr": 3, "length_psr": 1}
QUADRATURE_POINTS = 16  # directions of the albedo's quadrature
MAX_SPECULAR_BOUNCES = 4
# Korobov 1959: point i is i * LATTICE / QUADRATURE_POINTS; 5 had the least error of 3 .. 13
LATTICE = (1, 5, 25)


def render_gbuffer(
    tracer: Tracer, buffers: Collection[str] = BUFFERS
) -> dict[str, Float[Array, "h w channels"]]:
    """The G-buffer at the tracer's current time, float32 [h w c] by name, as in `GBuffer`.

    - albedo: see `specular.chain_albedo`; 0 for background.
    - normal: world space, towards the camera; 0 for background.
    - depth: along the view axis; +inf for background.
    - motion: pixels to the position one frame earlier, from the poses at `time` and `time - 1`
      (also for frame 0). It is exact for camera motion, rigid and deforming meshes; the motion of
      the background is the camera's rotation. Where another shot begins (`Scene.cuts`), it leads
      every pixel outside the previous frame, as if the history were dropped, even where both shots
      show the same surface.
    - object: 1 + index in `scene.meshes`, or one more than the last for other shapes; 0 for
      background.
    - albedo_first: albedo of the first surface itself.
    - normal_psr, depth_psr, object_psr: of the first surface with a rough lobe, at the end
      of the specular chain; depth as if the chain were a straight line.
    """
    height, width = tracer.height, tracer.width
    rows, columns = np.indices((height, width)).reshape(2, -1)
    film = np.stack([columns, rows], 1) + 0.5
    channels = _ray_channels(tracer, buffers)
    offsets = np.cumsum(list(channels.values()))[:-1]
    values = tracer.evaluate_rays(lambda ray: _query_ray(tracer, ray, channels), film)
    features = dict(zip(channels, np.split(np.stack(values, 1), offsets, 1), strict=True))
    hit, mesh, face = (features[name][:, 0] for name in ("hit", "mesh", "face"))
    u, v = (features[name][:, 0].astype(np.float32) for name in "uv")
    now, before = _visible_points(tracer, hit > 0, mesh, face, u, v, film, features.get("point"))
    position, depth = tracer.pose.project(now, height, width)
    features["depth"] = np.where(hit > 0, depth, np.inf)[:, None]
    previous, _ = Pose.at_time(tracer.scene, tracer.time - 1).project(before, height, width)
    is_cut = any(tracer.time - 1 < first <= tracer.time for first in tracer.scene.cuts)
    outside = np.full_like(position, CUT_MOTION) * (width, height)
    features["motion"] = outside if is_cut else previous - position
    features["object"] = np.where(hit > 0, mesh + 1, 0)[:, None]
    if "hit_psr" in features:
        is_hit = features["hit_psr"] > 0
        cosine = tracer.pose.ray_directions(film, height, width) @ tracer.pose.camera_axes()[2]
        depth_psr = features["length_psr"] * cosine[:, None]
        features["depth_psr"] = np.where(is_hit, depth_psr, np.inf)
        features["object_psr"] = np.where(is_hit, features["mesh_psr"] + 1, 0)
    return {
        name: features[name].reshape(height, width, -1).astype(np.float32)
        for name in BUFFER_CHANNELS
        if name in buffers
    }


def _ray_channels(tracer: Tracer, buffers: Collection[str]) -> dict[str, int]:
    """The quantities to compute for each ray, and their numbers of channels."""
    albedos = {name: 3 for name in ("albedo", "albedo_first") if name in buffers}
    behind = BEHIND if any(name.endswith("_psr") for name in buffers) else {}
    return HIT | albedos | behind | ({"point": 3} if tracer.scene.xml_file else {})


def _query_ray(tracer: Tracer, ray: Any, channels: Mapping[str, int]) -> tuple[Any, ...]:
    """The values of `channels` for a ray, one after the other; zeros if the ray hits nothing."""
    import drjit as dr
    import mitsuba as mi

    hit = tracer.mi_scene.ray_intersect_preliminary(ray)
    valid = hit.is_valid()
    if valid is False:  # scalar variant: the ray has left the scene
        return (0.0,) * sum(channels.values())
    surface = hit.compute_surface_interaction(ray, active=valid)
    uv = dr.select(valid, mi.Point2f(hit.prim_uv), mi.Point2f(0))
    face = dr.select(valid, hit.prim_index, mi.UInt32(0))
    features: dict[str, Any] = {"face": (face,), "u": (uv.x,), "v": (uv.y,)}
    features |= _surface_features(tracer, hit, surface, ray, valid)
    if "point" in channels:
        features["point"] = dr.select(valid, surface.p, mi.Point3f(0))
    if "albedo_first" in channels:
        share = dr.clip(reflectance(surface, ray, valid), 0, 1)
        features["albedo_first"] = dr.select(valid, share, mi.Color3f(0))
    if "albedo" in channels or "hit_psr" in channels:
        last, throughput, length, bounces = follow_specular_chain(tracer, ray)
        if "albedo" in channels:
            features["albedo"] = chain_albedo(tracer, last, throughput, bounces)
        if "hit_psr" in channels:
            features |= _features_psr(tracer, last, length)
    return tuple(value for name in channels for value in features[name])


def _surface_features(
    tracer: Tracer, hit: Any, surface: Any, ray: Any, valid: Any
) -> dict[str, Any]:
    """Whether there is a hit, its mesh index, and its normal towards the ray's origin."""
    import drjit as dr
    import mitsuba as mi

    normal = surface.sh_frame.n * dr.select(dr.dot(surface.n, ray.d) > 0, -1.0, 1.0)
    return {
        "hit": (dr.select(valid, mi.Float(1), mi.Float(0)),),
        "mesh": (tracer.mesh_index(hit),),
        "normal": dr.select(valid, normal, mi.Normal3f(0)),
    }


def _features_psr(tracer: Tracer, last: Any, length: Any) -> dict[str, Any]:
    """The same at the end of a specular chain, and the length of the whole chain."""
    hit = tracer.mi_scene.ray_intersect_preliminary(last)
    valid = hit.is_valid()
    if valid is False:
        return {name: (0.0,) * count for name, count in BEHIND.items()}
    surface = hit.compute_surface_interaction(last, active=valid)
    features = _surface_features(tracer, hit, surface, last, valid)
    named = {f"{name}_psr": values for name, values in features.items()}
    return named | {"length_psr": (length + hit.t,)}


def _visible_points(
    tracer: Tracer,
    hit: Array,
    mesh: Array,
    face: Array,
    u: Array,
    v: Array,
    film: Array,
    fixed: Array | None,
) -> tuple[Float[Array, "p 4"], Float[Array, "p 4"]]:
    """Homogeneous points that the pixels show, now and one frame earlier; directions if no hit.

    `fixed` are world positions of hits on shapes that are not in `scene.meshes` and never move.
    """
    meshes, earlier = tracer.scene.meshes, Pose.at_time(tracer.scene, tracer.time - 1)
    sky = np.column_stack(
        [tracer.pose.ray_directions(film, tracer.height, tracer.width), np.zeros(len(film))]
    )
    static = sky
    if fixed is not None:
        static = np.where(hit[:, None], np.column_stack([fixed, np.ones(len(film))]), sky)
    if not meshes:
        return static, static
    is_mesh = hit & (mesh < len(meshes))
    mesh, face = np.where(is_mesh, mesh, 0), np.where(is_mesh, face, 0)
    first_vertex = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces.astype(np.int64) + f for m, f in zip(meshes, first_vertex[:-1], strict=True)]
    corners = np.concatenate(faces)
    first_face = np.cumsum([0, *(len(m.faces) for m in meshes)])
    corners = corners[first_face[mesh.astype(np.int64)] + face.astype(np.int64)]
    barycentric = np.stack([1 - u - v, u, v], 1).astype(np.float64)[..., None]

    def points_at(pose: Pose) -> Array:
        vertices = np.concatenate(pose.vertices).astype(np.float64)
        points = np.column_stack([(vertices[corners] * barycentric).sum(1), np.ones(len(film))])
        return np.where(is_mesh[:, None], points, static)

    return points_at(tracer.pose), points_at(earlier)


def follow_specular_chain(tracer: Tracer, ray: Any) -> tuple[Any, Any, Any, Any]:
    """The last segment of a camera ray; throughput, length and bounces before that segment.

    Surfaces with only delta lobes are followed up to 4 times; at glass the chain takes the
    transmission. The last segment ends at the first surface with another lobe, or leaves the scene.
    """
    import drjit as dr
    import mitsuba as mi

    context = _bsdf_context()

    def bounce_once(
        ray: Any, throughput: Any, length: Any, bounces: Any, active: Any
    ) -> tuple[Any, ...]:
        surface = tracer.mi_scene.ray_intersect(ray, active)
        valid = active & surface.is_valid()
        if valid is False:  # scalar variant: the ray has left the scene, there is no BSDF
            return ray, throughput, length, bounces, False
        bsdf = surface.bsdf(ray)
        smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        onward = valid ^ (valid & (smooth | (bounces >= MAX_SPECULAR_BOUNCES)))
        chosen, weight = bsdf.sample(context, surface, 0.999, mi.Point2f(0.5, 0.5), onward)
        throughput = dr.select(onward, throughput * weight, throughput)
        length = dr.select(onward, length + surface.t, length)
        bounces = dr.select(onward, bounces + 1, bounces)
        after = mi.Ray3f(surface.spawn_ray(surface.to_world(chosen.wo)))
        return dr.select(onward, after, ray), throughput, length, bounces, onward

    start = (mi.Ray3f(ray), mi.Color3f(1), mi.Float(0), mi.UInt32(0), mi.Bool(True))
    return dr.while_loop(start, lambda *state: state[-1], bounce_once)[:4]


def chain_albedo(tracer: Tracer, last: Any, throughput: Any, bounces: Any) -> Any:
    """Albedo in [0, 1] at the end of a specular chain: reflectance times the chain's throughput.

    The reflectance is the mean of the BSDF's own sample weights over fixed points: its
    directional-hemispherical reflectance, for any BSDF. Mitsuba's own albedo AOV is far above 1, or
    0, for rough metal and glass. A chain that leaves the scene has its throughput as albedo, and
    background 0.
    """
    import drjit as dr
    import mitsuba as mi

    surface = tracer.mi_scene.ray_intersect(last)
    valid = surface.is_valid()
    beyond = dr.select(bounces > 0, throughput, mi.Color3f(0))
    if valid is False:
        return dr.clip(beyond, 0, 1)
    share = throughput * reflectance(surface, last, valid)
    return dr.clip(dr.select(valid, share, beyond), 0, 1)


def reflectance(surface: Any, ray: Any, active: Any) -> Any:
    """Directional-hemispherical reflectance plus transmittance of the surface that `ray` hits."""
    import drjit as dr
    import mitsuba as mi

    context, bsdf = _bsdf_context(), surface.bsdf(ray)

    def add_point(point: Any, total: Any) -> tuple[Any, Any]:
        choice, x, y = (
            _fraction((mi.Float(point) * step + 0.5) / QUADRATURE_POINTS) for step in LATTICE
        )
        _, weight = bsdf.sample(context, surface, choice, mi.Point2f(x, y), active)
        return point + 1, total + weight

    start = (mi.UInt32(0), mi.Color3f(0))
    total = dr.while_loop(start, lambda point, _: point < QUADRATURE_POINTS, add_point)[1]
    return total / QUADRATURE_POINTS


def _bsdf_context() -> Any:
    """Importance transport; with radiance transport, refraction scales weights by eta squared."""
    import mitsuba as mi

    return mi.BSDFContext(mi.TransportMode.Importance)


def _fraction(number: Any) -> Any:
    import drjit as dr

    return number - dr.floor(number)
