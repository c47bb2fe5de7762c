"""Specular chains: follows camera rays through glass and mirrors to the first rough surface.

Also the albedo there, which for every BSDF is its directional-hemispherical reflectance.
"""

from __future__ import annotations

from typing import Any

from rlbench.render.mitsuba.tracer import Tracer

__all__ = ["chain_albedo", "follow_specular_chain", "reflectance"]

QUADRATURE_POINTS = 16  # directions of the albedo's quadrature
MAX_SPECULAR_BOUNCES = 4
# Korobov 1959: point i is i * LATTICE / QUADRATURE_POINTS; 5 had the least error of 3 .. 13
LATTICE = (1, 5, 25)


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
