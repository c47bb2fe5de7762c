"""What a camera knows before any light is traced: albedo, normal, depth and exact motion.

All are of the pixel's centre. Normal, depth and motion are of the first surface, glass included, so
that they belong together; albedo looks through glass and mirrors.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.frames import BUFFERS
from rlbench.render.pose import Pose
from rlbench.render.tracer import Tracer

POINTS = 16  # directions of the albedo's quadrature
OUTSIDE = -2.0  # images, along both axes, that motion leads at a cut: no pixel gets inside
BOUNCES = 4  # mirrors and panes that albedo looks through
LATTICE = (
    1,
    5,
    25,
)  # Korobov 1959: point i is i * LATTICE / POINTS; 5 had the least error of 3 .. 13


def views(
    tracer: Tracer, needs: Collection[str] = BUFFERS
) -> dict[str, Float[Array, "h w channels"]]:
    """The buffers `needs` of the tracer's present time, float32, in the conventions of `View`.

    albedo: see `albedo`; 0 for background. normal: world space, towards the camera. depth: along
    the view axis, +inf for background. motion: to the position one frame earlier, from the poses at
    `time` and `time - 1` (also for frame 0), so exact for camera, rigid and deforming motion; that
    of background is the camera's rotation. Where another shot begins, at a frame of `Scene.cuts`,
    every pixel comes from OUTSIDE the previous frame, though some of what it shows may have been
    seen there: an engine knows that its camera was cut, drops its history, and knows no more.
    """
    height, width = tracer.height, tracer.width
    rows, columns = np.indices((height, width)).reshape(2, -1)
    film = np.stack([columns, rows], 1) + 0.5
    hit, mesh, face, u, v, *shaded = tracer.each(
        lambda ray: _look(tracer, ray, "albedo" in needs), film
    )
    found = {"albedo": np.stack(shaded[:3], 1), "normal": np.stack(shaded[3:6], 1)}
    fixed = np.stack(shaded[6:], 1) if tracer.scene.document else None
    now, before = _points(tracer, hit > 0, mesh, face, u, v, film, fixed)
    here, depth = tracer.pose.project(now, height, width)
    found["depth"] = np.where(hit > 0, depth, np.inf)[:, None]
    there, _ = Pose.of(tracer.scene, tracer.time - 1).project(before, height, width)
    cut = any(tracer.time - 1 < first <= tracer.time for first in tracer.scene.cuts)
    found["motion"] = np.full_like(here, OUTSIDE) * (width, height) if cut else there - here
    return {
        name: found[name].reshape(height, width, -1).astype(np.float32)
        for name in BUFFERS
        if name in needs
    }


def albedo(tracer: Tracer, ray: Any) -> Any:
    """Share of light that the surface behind `ray` reflects or passes on, in [0, 1].

    The mean of the BSDF's own sample weights over fixed points: its directional-hemispherical
    reflectance, whatever the BSDF. Surfaces that are only mirror or glass are followed up to 4
    times, through the pane rather than off it, and tint what lies behind; a mirror that shows the
    sky has its own tint. Mitsuba's own albedo is far above 1 or 0 for rough metal and glass.
    """
    import drjit as dr
    import mitsuba as mi

    # importance transport, or refraction would scale the weights by the squared index of refraction
    context = mi.BSDFContext(mi.TransportMode.Importance)

    def follow(ray: Any, tint: Any, result: Any, bounce: Any, active: Any) -> tuple[Any, ...]:
        surface = tracer.mitsuba.ray_intersect(ray, active)
        valid = active & surface.is_valid()
        if valid is False:  # a single ray that has left the scene: there is no BSDF to ask
            return ray, tint, tint if bounce > 0 else result, bounce, False
        bsdf = surface.bsdf(ray)
        smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        ends = valid & (smooth | (bounce >= BOUNCES))
        share = _reflectance(context, bsdf, surface, ends)
        result = dr.select(ends, tint * share, result)
        result = dr.select((active ^ valid) & (bounce > 0), tint, result)
        onward = valid ^ ends
        chosen, weight = bsdf.sample(context, surface, 0.999, mi.Point2f(0.5, 0.5), onward)
        tint = dr.select(onward, tint * weight, tint)
        ray = surface.spawn_ray(surface.to_world(chosen.wo))
        return mi.Ray3f(ray), tint, result, bounce + 1, onward

    start = (mi.Ray3f(ray), mi.Color3f(1), mi.Color3f(0), mi.UInt32(0), mi.Bool(True))
    end = dr.while_loop(start, lambda *state: state[-1], follow)
    return dr.clip(end[2], 0, 1)


def _look(tracer: Tracer, ray: Any, coloured: bool) -> tuple[Any, ...]:
    """Is there a hit? Mesh, face and place in it; albedo, normal; of a document, where it is."""
    import drjit as dr
    import mitsuba as mi

    hit = tracer.mitsuba.ray_intersect_preliminary(ray)
    valid = hit.is_valid()
    if valid is False:
        return (0.0,) * (14 if tracer.scene.document else 11)
    surface = hit.compute_surface_interaction(ray, active=valid)
    normal = surface.sh_frame.n * dr.select(dr.dot(surface.n, ray.d) > 0, -1, 1)
    normal = dr.select(valid, normal, mi.Normal3f(0))
    colour = albedo(tracer, ray) if coloured else mi.Color3f(0)
    place = dr.select(valid, mi.Point2f(hit.prim_uv), mi.Point2f(0))
    where = (tracer.mesh(hit), dr.select(valid, hit.prim_index, mi.UInt32(0)), place.x, place.y)
    point = dr.select(valid, surface.p, mi.Point3f(0)) if tracer.scene.document else ()
    return (dr.select(valid, mi.Float(1), mi.Float(0)), *where, *colour, *normal, *point)


def _reflectance(context: Any, bsdf: Any, surface: Any, active: Any) -> Any:
    import drjit as dr
    import mitsuba as mi

    if active is False:
        return mi.Color3f(0)

    def add(point: Any, total: Any) -> tuple[Any, Any]:
        choice, x, y = (_fraction((mi.Float(point) * step + 0.5) / POINTS) for step in LATTICE)
        _, weight = bsdf.sample(context, surface, choice, mi.Point2f(x, y), active)
        return point + 1, total + weight

    start = (mi.UInt32(0), mi.Color3f(0))
    return dr.while_loop(start, lambda point, _: point < POINTS, add)[1] / POINTS


def _fraction(number: Any) -> Any:
    import drjit as dr

    return number - dr.floor(number)


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
