"""Inspects all frames of a user's scene before rendering: visible surfaces, light, and exposure."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.apps.render.scene import SceneError
from rlbench.clips.exposure import area_luminance, exposure_from_areas

GRID = 32  # rays along each side of the image
SPP = (4, 64)  # samples per ray; the second number if the first gave a black image


def measure_distance(tracer: Tracer) -> float:
    """Distance to the surface in the middle of the image, in scene units, to three digits.

    The median over the middle quarter. Raises SceneError if no surface is visible there.
    """
    hits = hit_distances(tracer)[0].reshape(GRID, GRID)
    middle = hits[GRID // 4 : -GRID // 4, GRID // 4 : -GRID // 4]
    visible = middle[np.isfinite(middle)]
    if not len(visible):
        raise SceneError(
            f"{_describe_camera(tracer)} sees no surface in the middle of the image to move "
            "around. Use --camera still, or a JSON file of matrices"
        )
    return float(f"{np.median(visible):.3g}")


def estimate_exposure(tracer: Tracer, frames: int) -> float:
    """An exposure for all frames, to two digits, after a check of every frame.

    The log-average luminance over 8 x 8 areas of all frames becomes 0.18 (Reinhard et al. 2002,
    Photographic Tone Reproduction), or less if more than 5 % of the areas would exceed white.
    Raises SceneError for a frame without any visible surface, or without light.
    """
    if not tracer.mi_scene.emitters():
        raise SceneError(
            "the scene has no light, so all images would be black. Add an emitter, or --sky 1"
        )
    areas, has_surface = [], False
    with mitsuba_errors():
        for index in range(frames):
            tracer.set_time(float(index))
            is_hit = np.isfinite(hit_distances(tracer)[0])
            if not is_hit.any() and not tracer.mi_scene.environment():
                raise SceneError(_no_surface(tracer))
            has_surface = has_surface or bool(is_hit.any())
            areas.append(trace_areas(tracer))
        if not has_surface:
            raise SceneError(_no_surface(tracer))
        render_gbuffer(tracer)
    return exposure_from_areas(np.stack(areas))


def hit_distances(tracer: Tracer) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """For each ray of the grid: distance to the first surface, and 1 if that is a back face."""
    import drjit as dr
    import mitsuba as mi

    def query(ray: Any) -> tuple[Any, Any]:
        hit = tracer.mi_scene.ray_intersect_preliminary(ray)
        valid = hit.is_valid()
        if valid is False:
            return np.inf, 0.0
        surface = hit.compute_surface_interaction(ray, active=valid)
        is_back = valid & (dr.dot(surface.n, ray.d) > 0)
        return dr.select(valid, hit.t, np.inf), dr.select(is_back, mi.Float(1), mi.Float(0))

    step = (np.arange(GRID) + 0.5) / GRID
    across, down = np.meshgrid(step * tracer.width, step * tracer.height)
    distances, is_back = tracer.evaluate_rays(query, np.stack([across.ravel(), down.ravel()], 1))
    return distances, is_back


def trace_areas(tracer: Tracer) -> Float[Array, " areas"]:
    """Luminance of 8 x 8 areas of the current frame. Raises SceneError if all of it is black."""
    step = (np.arange(GRID) + 0.5) / GRID
    rows, columns = ((step * side).astype(np.uint32) for side in (tracer.height, tracer.width))
    pixels = (rows[:, None] * np.uint32(tracer.width) + columns).ravel()
    for spp in SPP:
        numbers = np.repeat(np.arange(spp, dtype=np.uint32), len(pixels))
        radiance = tracer.trace(np.tile(pixels, spp), numbers, "pilot")
        finite = np.nan_to_num(radiance, posinf=0.0).reshape(spp, GRID, GRID, 3)
        areas = area_luminance(finite.mean(0, dtype=np.float64))
        if areas.max() > 0:
            return areas
    distances, is_back = hit_distances(tracer)
    raise SceneError(
        f"{_describe_camera(tracer)} sees only black: the nearest surface is {distances.min():.3g} "
        f"away, and {is_back.mean():.0%} of what it sees are backs of surfaces. It may be inside a "
        "wall or a closed object, or (as near_clip is ignored) behind one; or no light reaches "
        "what it sees. Move it with --camera path.json, or check the lights"
    )


def _no_surface(tracer: Tracer) -> str:
    box = tracer.mi_scene.bbox()
    return (
        f"{_describe_camera(tracer)} sees no surface; the scene spans {_format_point(box.min)} to "
        f"{_format_point(box.max)}. Matrices are camera-to-world, and cameras look along +z"
    )


def _describe_camera(tracer: Tracer) -> str:
    position, forward = tracer.pose.camera.origin, tracer.pose.camera_axes()[2]
    return (
        f"frame {tracer.time:.0f}: the camera at {_format_point(position)}, which looks along "
        f"{_format_point(forward)},"
    )


def _format_point(point: Any) -> str:
    return f"({', '.join(f'{float(v):.3g}' for v in point)})"


@contextmanager
def mitsuba_errors() -> Iterator[None]:
    """Raises Mitsuba's errors, such as for spectra that RGB variants lack, as SceneError."""
    try:
        yield
    except RuntimeError as error:
        messages: list[str] = []
        cause: BaseException | None = error
        while cause is not None:
            messages.append(str(cause))
            cause = cause.__cause__ or cause.__context__
        raise SceneError(
            f"Mitsuba cannot trace this scene with {_variant()}: {': '.join(messages)}"
        ) from error


def _variant() -> str:
    import mitsuba as mi

    return str(mi.variant())
