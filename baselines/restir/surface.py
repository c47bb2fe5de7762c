"""What the camera's rays have hit, and what a sample of the lights gives there.

A sample of the lights is not kept as a point on one, but as the two random numbers in [0, 1) from
which Mitsuba makes it (Kelemen et al. 2002 call this primary sample space). To which lamp they
lead, and where on it, is the same for every pixel as long as the light's own sampling does not
depend on who is lit; where it does, as with spheres, the numbers stay and the point follows. Either
way every pixel integrates over the same square with density 1, so that a sample needs no Jacobian
when another pixel takes it over, and one that was found on a lamp which moves goes with the lamp.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Surface:
    """First surfaces along rays, lane by lane."""

    scene: Any  # mi.Scene
    ray: Any  # mi.RayDifferential3f
    hit: Any  # mi.SurfaceInteraction3f
    bsdf: Any  # mi.BSDFPtr
    lit: Any  # mi.Bool: is there a surface which is not only mirror or glass?

    @classmethod
    def of(cls, scene: Any, ray: Any, hit: Any) -> Surface:
        """The surface of a preliminary intersection of `ray`."""
        import mitsuba as mi

        found = hit.compute_surface_interaction(ray)
        bsdf = found.bsdf(ray)
        smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        return cls(scene, ray, found, bsdf, found.is_valid() & smooth)

    @property
    def normal(self) -> Any:
        """The shading normal on the side of the ray."""
        import drjit as dr

        return dr.select(dr.dot(self.hit.n, self.ray.d) > 0, -1, 1) * self.hit.sh_frame.n

    @property
    def material(self) -> Any:
        """A number for the BSDF."""
        import drjit as dr
        import mitsuba as mi

        return dr.reinterpret_array(mi.UInt32, self.bsdf)

    def light(self, place: Any, active: Any) -> tuple[Any, Any]:
        """What the lights' sample `place` (mi.Point2f) gives, unshadowed, and where it lies.

        Radiance times BSDF times cosine, divided by the density of the sample: L_e f G / p.
        """
        import drjit as dr
        import mitsuba as mi

        active = active & self.lit
        towards, weight = self.scene.sample_emitter_direction(self.hit, place, False, active)
        active &= towards.pdf != 0
        local = self.hit.to_local(towards.d)
        value = self.bsdf.eval(mi.BSDFContext(), self.hit, local, active)
        return dr.select(active, value * weight, 0), towards.p

    def target(self, place: Any, active: Any) -> Any:
        """Luminance of what `light` gives: what reservoirs draw in proportion to."""
        return brightness(self.light(place, active)[0])

    def sees(self, point: Any, active: Any) -> Any:
        """Is nothing between the surface and a point on a light?"""
        active = active & self.lit
        return active & ~self.scene.ray_test(self.hit.spawn_ray_to(point), active)


def brightness(colour: Any) -> Any:
    """Luminance, or 0 where it is not a number that can be reckoned with."""
    import drjit as dr
    import mitsuba as mi

    value = mi.luminance(colour)
    return dr.select(dr.isfinite(value) & (value > 0), value, 0)
