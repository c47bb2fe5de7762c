"""What a path tracer finds beyond a first surface, without the light that reservoirs give."""

from __future__ import annotations

from typing import Any

from baselines.restir.surface import Surface


def indirect(surface: Surface, path: Any, numbers: Any) -> Any:
    """Radiance that comes to first surfaces by others, by one continuation of the path each.

    `path` is a Mitsuba integrator and `numbers` its sampler. The direction is drawn by the BSDF.
    Where its lobe was not a mirror, what the lamp that it meets gives at once is taken off again:
    that is direct light, which the reservoirs have. Where it was one, no sample of the lights can
    give it, and it stays.
    """
    import drjit as dr
    import mitsuba as mi

    scene, hit = surface.scene, surface.hit
    valid = hit.is_valid()
    sample, weight = surface.bsdf.sample(
        mi.BSDFContext(), hit, numbers.next_1d(), numbers.next_2d(), valid
    )
    valid &= dr.any(weight != 0)
    onward = mi.RayDifferential3f(hit.spawn_ray(hit.to_world(sample.wo)))
    light, _, _ = path.sample(scene, numbers, onward, active=valid)
    mirror = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    met = scene.ray_intersect(onward, valid & ~mirror)
    lamp = met.emitter(scene).eval(met, valid & ~mirror)
    rest = dr.select(mirror, light, dr.maximum(light - lamp, 0))
    return dr.select(valid, weight * rest, 0)
