"""What a camera knows before any light is traced: albedo, normal, depth and exact motion.

All are of the pixel's centre. Normal, depth and motion are of the first surface, glass included, so
that they belong together; albedo looks through glass and mirrors. Beside them there are, where they
are asked for, the object that is hit, the first surface's own albedo, and what lies behind glass
and mirrors.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.clips.header import VIEWS
from rlbench.frames import BUFFERS
from rlbench.render.mitsuba.specular import albedo, follow_specular_chain, reflectance
from rlbench.render.mitsuba.tracer import Tracer
from rlbench.render.pose import Pose

OUTSIDE = -2.0  # images, along both axes, that motion leads at a cut: no pixel gets inside
HIT = {"hit": 1, "mesh": 1, "face": 1, "u": 1, "v": 1, "normal": 3}  # channels of a first look
BEHIND = {"hit_psr": 1, "mesh_psr": 1, "normal_psr": 3, "length_psr": 1}


def render_gbuffer(
    tracer: Tracer, needs: Collection[str] = BUFFERS
) -> dict[str, Float[Array, "h w channels"]]:
    """The buffers `needs` of the tracer's present time, float32, in the conventions of `View`.

    albedo: see `through.albedo`; 0 for background. normal: world space, towards the camera. depth:
    along the view axis, +inf for background. motion: to the position one frame earlier, from the
    poses at `time` and `time - 1` (also for frame 0), so exact for camera, rigid and deforming
    motion; that of background is the camera's rotation. Where another shot begins, at a frame of
    `Scene.cuts`, every pixel comes from OUTSIDE the previous frame, though some of what it shows
    may have been seen there: an engine knows that its camera was cut, drops its history, and knows
    no more.

    object: 1 + the place in `scene.meshes`, or one more than the last of them for any other shape;
    0 for background. albedo_first: of the first surface itself. normal_behind, depth_behind and
    object_behind: of the first surface that is not only mirror or glass, found as albedo finds it;
    depth as if the way there had no bends.
    """
    height, width = tracer.height, tracer.width
    rows, columns = np.indices((height, width)).reshape(2, -1)
    film = np.stack([columns, rows], 1) + 0.5
    channels = _channels(tracer, needs)
    parts = np.cumsum(list(channels.values()))[:-1]
    seen = tracer.each(lambda ray: _look(tracer, ray, channels), film)
    found = dict(zip(channels, np.split(np.stack(seen, 1), parts, 1), strict=True))
    hit, mesh, face = (found[name][:, 0] for name in ("hit", "mesh", "face"))
    u, v = (found[name][:, 0].astype(np.float32) for name in "uv")
    now, before = _points(tracer, hit > 0, mesh, face, u, v, film, found.get("point"))
    here, depth = tracer.pose.project(now, height, width)
    found["depth"] = np.where(hit > 0, depth, np.inf)[:, None]
    there, _ = Pose.of(tracer.scene, tracer.time - 1).project(before, height, width)
    cut = any(tracer.time - 1 < first <= tracer.time for first in tracer.scene.cuts)
    found["motion"] = np.full_like(here, OUTSIDE) * (width, height) if cut else there - here
    found["object"] = np.where(hit > 0, mesh + 1, 0)[:, None]
    if "hit_psr" in found:
        ends = found["hit_psr"] > 0
        ahead = tracer.pose.directions(film, height, width) @ tracer.pose.axes()[2]
        found["depth_psr"] = np.where(ends, found["length_psr"] * ahead[:, None], np.inf)
        found["object_psr"] = np.where(ends, found["mesh_psr"] + 1, 0)
    return {
        name: found[name].reshape(height, width, -1).astype(np.float32)
        for name in VIEWS
        if name in needs
    }


def _channels(tracer: Tracer, needs: Collection[str]) -> dict[str, int]:
    """What has to be looked at along each ray, and how many numbers it is."""
    more = {name: 3 for name in ("albedo", "albedo_first") if name in needs}
    behind = BEHIND if any(name.endswith("_psr") for name in needs) else {}
    return HIT | more | behind | ({"point": 3} if tracer.scene.document else {})


def _look(tracer: Tracer, ray: Any, channels: Mapping[str, int]) -> tuple[Any, ...]:
    """The numbers of `channels` along a ray, one after the other; zeros where nothing is hit."""
    import drjit as dr
    import mitsuba as mi

    hit = tracer.mitsuba.ray_intersect_preliminary(ray)
    valid = hit.is_valid()
    if valid is False:  # a single ray that has left the scene
        return (0.0,) * sum(channels.values())
    surface = hit.compute_surface_interaction(ray, active=valid)
    place = dr.select(valid, mi.Point2f(hit.prim_uv), mi.Point2f(0))
    face = dr.select(valid, hit.prim_index, mi.UInt32(0))
    found: dict[str, Any] = {"face": (face,), "u": (place.x,), "v": (place.y,)}
    found |= _met(tracer, hit, surface, ray, valid)
    if "point" in channels:
        found["point"] = dr.select(valid, surface.p, mi.Point3f(0))
    if "albedo_first" in channels:
        share = dr.clip(reflectance(surface, ray, valid), 0, 1)
        found["albedo_first"] = dr.select(valid, share, mi.Color3f(0))
    if "albedo" in channels or "hit_psr" in channels:
        last, tint, length, bounces = follow_specular_chain(tracer, ray)
        if "albedo" in channels:
            found["albedo"] = albedo(tracer, last, tint, bounces)
        if "hit_psr" in channels:
            found |= _behind(tracer, last, length)
    return tuple(number for name in channels for number in found[name])


def _met(tracer: Tracer, hit: Any, surface: Any, ray: Any, valid: Any) -> dict[str, Any]:
    """Is there a hit, of which mesh, and its normal towards the ray?"""
    import drjit as dr
    import mitsuba as mi

    normal = surface.sh_frame.n * dr.select(dr.dot(surface.n, ray.d) > 0, -1, 1)
    return {
        "hit": (dr.select(valid, mi.Float(1), mi.Float(0)),),
        "mesh": (tracer.mesh(hit),),
        "normal": dr.select(valid, normal, mi.Normal3f(0)),
    }


def _behind(tracer: Tracer, last: Any, length: Any) -> dict[str, Any]:
    """The same of the last part of a way, and how long all of it is."""
    hit = tracer.mitsuba.ray_intersect_preliminary(last)
    valid = hit.is_valid()
    if valid is False:
        return {name: (0.0,) * count for name, count in BEHIND.items()}
    surface = hit.compute_surface_interaction(last, active=valid)
    met = _met(tracer, hit, surface, last, valid)
    found = {f"{name}_psr": numbers for name, numbers in met.items()}
    return found | {"length_psr": (length + hit.t,)}


def _points(
    tracer: Tracer,
    hit: Array,
    mesh: Array,
    face: Array,
    u: Array,
    v: Array,
    film: Array,
    fixed: Array | None,
) -> tuple[Float[Array, "p 4"], Float[Array, "p 4"]]:
    """What is seen at each pixel, now and one frame earlier; directions where nothing is hit.

    `fixed` are the points hit, which stay where they are unless they are of `scene.meshes`.
    """
    meshes, earlier = tracer.scene.meshes, Pose.of(tracer.scene, tracer.time - 1)
    sky = np.column_stack(
        [tracer.pose.directions(film, tracer.height, tracer.width), np.zeros(len(film))]
    )
    rest = sky
    if fixed is not None:
        rest = np.where(hit[:, None], np.column_stack([fixed, np.ones(len(film))]), sky)
    if not meshes:
        return rest, rest
    moves = hit & (mesh < len(meshes))
    mesh, face = np.where(moves, mesh, 0), np.where(moves, face, 0)
    first = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces.astype(np.int64) + f for m, f in zip(meshes, first[:-1], strict=True)]
    corners = np.concatenate(faces)
    start = np.cumsum([0, *(len(m.faces) for m in meshes)])
    corners = corners[start[mesh.astype(np.int64)] + face.astype(np.int64)]
    shares = np.stack([1 - u - v, u, v], 1).astype(np.float64)[..., None]

    def place(pose: Pose) -> Array:
        vertices = np.concatenate(pose.vertices).astype(np.float64)
        points = np.column_stack([(vertices[corners] * shares).sum(1), np.ones(len(film))])
        return np.where(moves[:, None], points, rest)

    return place(tracer.pose), place(earlier)
