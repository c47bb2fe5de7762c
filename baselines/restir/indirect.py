"""Indirect light: one path-traced continuation per pixel, without the direct light of ReSTIR."""

from __future__ import annotations

from typing import Any

from baselines.restir.surface import Surface

__all__ = ["trace_indirect"]


def trace_indirect(surface: Surface, path: Any, sampler: Any) -> Any:
    """Radiance that reaches the first surfaces from other surfaces, by one path each.

    `path` is a Mitsuba integrator and `sampler` its random number generator. The BSDF draws the
    direction. If the lobe was not a delta lobe, the emission at the path's next hit is subtracted,
    because that is direct light, which the reservoirs provide. Light samples cannot provide it for
    delta lobes (mirror and glass), so there it stays.
    """
    import drjit as dr
    import mitsuba as mi

    scene, hit = surface.scene, surface.hit
    valid = hit.is_valid()
    sample, weight = surface.bsdf.sample(
        mi.BSDFContext(), hit, sampler.next_1d(), sampler.next_2d(), valid
    )
    valid &= dr.any(weight != 0)
    ray = mi.RayDifferential3f(hit.spawn_ray(hit.to_world(sample.wo)))
    radiance, _, _ = path.sample(scene, sampler, ray, active=valid)
    is_delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    next_hit = scene.ray_intersect(ray, valid & ~is_delta)
    direct = next_hit.emitter(scene).eval(next_hit, valid & ~is_delta)
    indirect = dr.select(is_delta, radiance, dr.maximum(radiance - direct, 0))
    return dr.select(valid, weight * indirect, 0)
