"""First surfaces along camera rays, and the direct and indirect light that they reflect.

A light sample is not stored as a point on a light, but as the two random numbers in [0, 1) from
which Mitsuba samples the emitters (primary sample space, Kelemen et al. 2002). All pixels map them
to the same point on the same emitter if the emitter's sampling does not depend on the lit point;
where it does, as for spheres, the numbers stay and the point differs. Either way every pixel
integrates over the same unit square with density 1, so a reused sample needs no Jacobian, and a
sample on a moving emitter moves with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Surface:
    """First surfaces along rays, one per lane."""

    scene: Any  # mi.Scene
    ray: Any  # mi.RayDifferential3f
    hit: Any  # mi.SurfaceInteraction3f
    bsdf: Any  # mi.BSDFPtr
    has_non_delta_lobe: Any  # mi.Bool: there is a surface, and not of mirror or glass alone

    @classmethod
    def from_intersection(cls, scene: Any, ray: Any, intersection: Any) -> Surface:
        """The surface at a preliminary intersection of `ray`."""
        import mitsuba as mi

        hit = intersection.compute_surface_interaction(ray)
        bsdf = hit.bsdf(ray)
        non_delta = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        return cls(scene, ray, hit, bsdf, hit.is_valid() & non_delta)

    @property
    def normal(self) -> Any:
        """The shading normal, towards the ray's origin."""
        import drjit as dr

        return dr.select(dr.dot(self.hit.n, self.ray.d) > 0, -1.0, 1.0) * self.hit.sh_frame.n

    @property
    def bsdf_index(self) -> Any:
        """Mitsuba's index of the BSDF, mi.UInt32."""
        import drjit as dr
        import mitsuba as mi

        return dr.reinterpret_array(mi.UInt32, self.bsdf)

    def direct_light(self, sample: Any, active: Any) -> tuple[Any, Any]:
        """Unshadowed reflected radiance of a light sample (mi.Point2f), and its point in space.

        Emitted radiance times BSDF times cosine over the sample's density: L_e f G / p.
        """
        import drjit as dr
        import mitsuba as mi

        active = active & self.has_non_delta_lobe
        direction, weight = self.scene.sample_emitter_direction(self.hit, sample, False, active)
        active &= direction.pdf != 0
        local = self.hit.to_local(direction.d)
        value = self.bsdf.eval(mi.BSDFContext(), self.hit, local, active)
        return dr.select(active, value * weight, 0), direction.p

    def target(self, sample: Any, active: Any) -> Any:
        """The reservoirs' target function: luminance of `direct_light`."""
        return finite_luminance(self.direct_light(sample, active)[0])

    def is_visible(self, point: Any, active: Any) -> Any:
        """Whether nothing lies between the surface and a point on a light."""
        active = active & self.has_non_delta_lobe
        return active & ~self.scene.ray_test(self.hit.spawn_ray_to(point), active)


def finite_luminance(colour: Any) -> Any:
    """Luminance, or 0 where it is negative or not finite."""
    import drjit as dr
    import mitsuba as mi

    value = mi.luminance(colour)
    return dr.select(dr.isfinite(value) & (value > 0), value, 0)


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
