"""Looking through glass and mirrors, to the first surface that scatters; and what it reflects."""

from __future__ import annotations

from typing import Any

from rlbench.render.mitsuba.tracer import Tracer

QUADRATURE_POINTS = 16  # directions of the albedo's quadrature
MAX_SPECULAR_BOUNCES = 4  # mirrors and panes that are looked through
LATTICE = (
    1,
    5,
    25,
)  # Korobov 1959: point i is i * LATTICE / POINTS; 5 had the least error of 3 .. 13


def follow_specular_chain(tracer: Tracer, ray: Any) -> tuple[Any, Any, Any, Any]:
    """The last part of the way of `ray`, the tint of what came before, its length, its bounces.

    Surfaces that are only mirror or glass are followed up to 4 times, through the pane rather than
    off it. The last part ends at the first surface that scatters, or nowhere.
    """
    import drjit as dr
    import mitsuba as mi

    context = _context()

    def follow(ray: Any, tint: Any, length: Any, bounce: Any, active: Any) -> tuple[Any, ...]:
        surface = tracer.mi_scene.ray_intersect(ray, active)
        valid = active & surface.is_valid()
        if valid is False:  # a single ray that has left the scene: there is no BSDF to ask
            return ray, tint, length, bounce, False
        bsdf = surface.bsdf(ray)
        smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        onward = valid ^ (valid & (smooth | (bounce >= MAX_SPECULAR_BOUNCES)))
        chosen, weight = bsdf.sample(context, surface, 0.999, mi.Point2f(0.5, 0.5), onward)
        tint = dr.select(onward, tint * weight, tint)
        length = dr.select(onward, length + surface.t, length)
        bounce = dr.select(onward, bounce + 1, bounce)
        after = mi.Ray3f(surface.spawn_ray(surface.to_world(chosen.wo)))
        return dr.select(onward, after, ray), tint, length, bounce, onward

    start = (mi.Ray3f(ray), mi.Color3f(1), mi.Float(0), mi.UInt32(0), mi.Bool(True))
    return dr.while_loop(start, lambda *state: state[-1], follow)[:4]


def chain_albedo(tracer: Tracer, last: Any, tint: Any, bounces: Any) -> Any:
    """Share of light that the surface at the end of a way passes back along it, in [0, 1].

    The mean of the BSDF's own sample weights over fixed points: its directional-hemispherical
    reflectance, whatever the BSDF, times the `tint` of mirrors and panes before it; a mirror that
    shows the sky has its own tint, and the sky none. Mitsuba's own albedo is far above 1 or 0 for
    rough metal and glass.
    """
    import drjit as dr
    import mitsuba as mi

    surface = tracer.mi_scene.ray_intersect(last)
    valid = surface.is_valid()
    beyond = dr.select(bounces > 0, tint, mi.Color3f(0))
    if valid is False:
        return dr.clip(beyond, 0, 1)
    share = tint * reflectance(surface, last, valid)
    return dr.clip(dr.select(valid, share, beyond), 0, 1)


def reflectance(surface: Any, ray: Any, active: Any) -> Any:
    """Directional-hemispherical reflectance, and transmittance, of a surface that `ray` has hit."""
    import drjit as dr
    import mitsuba as mi

    context, bsdf = _context(), surface.bsdf(ray)

    def add(point: Any, total: Any) -> tuple[Any, Any]:
        choice, x, y = (
            _fraction((mi.Float(point) * step + 0.5) / QUADRATURE_POINTS) for step in LATTICE
        )
        _, weight = bsdf.sample(context, surface, choice, mi.Point2f(x, y), active)
        return point + 1, total + weight

    start = (mi.UInt32(0), mi.Color3f(0))
    return (
        dr.while_loop(start, lambda point, _: point < QUADRATURE_POINTS, add)[1] / QUADRATURE_POINTS
    )


def _context() -> Any:
    """Importance transport, or refraction would scale weights by the squared refractive index."""
    import mitsuba as mi

    return mi.BSDFContext(mi.TransportMode.Importance)


def _fraction(number: Any) -> Any:
    import drjit as dr

    return number - dr.floor(number)
