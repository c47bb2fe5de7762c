"""Reservoirs of a frame and the surfaces that they belong to, for reuse by other lanes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from baselines.restir.reservoir import Reservoir, empty_reservoirs
from baselines.restir.surface import Surface

__all__ = ["History"]

MAX_DEPTH_DIFFERENCE = 0.1  # relative, between surfaces that share reservoirs
MIN_NORMAL_COSINE = math.cos(math.radians(25))


@dataclass
class History:
    """Reservoirs with their surfaces, one per lane."""

    reservoir: Reservoir
    normal: Any  # mi.Normal3f, towards the camera
    distance: Any  # mi.Float: from the camera to the surface
    bsdf_index: Any  # mi.UInt32
    ray: tuple[Any, ...]  # origin and direction, for unbiased reuse only

    @classmethod
    def from_frame(cls, reservoir: Reservoir, surface: Surface, with_rays: bool) -> History:
        """The reservoirs of a frame with their surfaces, evaluated."""
        import drjit as dr

        ray = (surface.ray.o, surface.ray.d) if with_rays else ()
        history = cls(reservoir, surface.normal, surface.hit.t, surface.bsdf_index, ray)
        dr.eval(reservoir, history.normal, history.distance, history.bsdf_index, history.ray)
        return history

    @classmethod
    def empty(cls, lanes: int, with_rays: bool) -> History:
        """No reservoirs: the history before the first frame."""
        import drjit as dr
        import mitsuba as mi

        zeros = [dr.opaque(mi.Float, 0, (lanes,)) for _ in range(10)]
        ray = (mi.Point3f(zeros[4:7]), mi.Vector3f(zeros[7:10])) if with_rays else ()
        bsdf_index = dr.opaque(mi.UInt32, 0, (lanes,))
        return cls(empty_reservoirs(lanes), mi.Normal3f(zeros[:3]), zeros[3], bsdf_index, ray)

    def is_same_surface(self, surface: Surface, lane: Any, active: Any) -> Any:
        """Whether distance, normal and BSDF at `lane` agree with those of `surface`."""
        import drjit as dr
        import mitsuba as mi

        normal = mi.Normal3f([dr.gather(mi.Float, self.normal[c], lane, active) for c in range(3)])
        distance = dr.gather(mi.Float, self.distance, lane, active)
        near = dr.abs(distance - surface.hit.t) < MAX_DEPTH_DIFFERENCE * surface.hit.t
        same_bsdf = dr.gather(mi.UInt32, self.bsdf_index, lane, active) == surface.bsdf_index
        return same_bsdf & near & (dr.dot(normal, surface.normal) > MIN_NORMAL_COSINE)

    def rays_of(self, lane: Any, active: Any) -> Any:
        """The stored camera rays of other lanes."""
        import drjit as dr
        import mitsuba as mi

        origin, direction = (
            mi.Vector3f([dr.gather(mi.Float, part[c], lane, active) for c in range(3)])
            for part in self.ray
        )
        return mi.RayDifferential3f(mi.Point3f(origin), direction)
