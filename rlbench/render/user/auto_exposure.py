"""What a user's camera sees, found out before anything is written: surfaces, light, brightness."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.tracer import Tracer
from rlbench.render.scene import SceneError

GRID = 32  # rays along each side of the picture
AREAS = 8  # along each side; brightness is averaged over them first, as samples are noisy
SPP = (4, 64)  # samples of each ray; the second where the first found no light at all
GREY, WHITE = 0.18, 1.0  # display values of the average, and of what 95 % of the picture is below


def measure_distance(tracer: Tracer) -> float:
    """How far away is what the middle of the picture shows, to three digits, in scene units.

    The median over its middle quarter. Raises SceneError where that shows no surface.
    """
    lengths = _hits(tracer)[0].reshape(GRID, GRID)[GRID // 4 : -GRID // 4, GRID // 4 : -GRID // 4]
    seen = lengths[np.isfinite(lengths)]
    if not len(seen):
        raise SceneError(
            f"{_camera(tracer)} sees no surface in the middle of the picture, so there is nothing "
            "to move around; use --camera still, or a JSON file of matrices"
        )
    return float(f"{np.median(seen):.3g}")


def estimate_exposure(tracer: Tracer, frames: int) -> float:
    """Look at every frame, and say what exposure shows them at a usual brightness, to two digits.

    The log-average luminance over 8 x 8 areas of all frames becomes 0.18 (Reinhard et al. 2002,
    Photographic Tone Reproduction), or less if more than 5 % of the areas would exceed white.
    Raises SceneError for a frame that shows no surface, or no light.
    """
    if not tracer.mi_scene.emitters():
        raise SceneError("the scene has no light: every picture would be black; add an emitter")
    bright, seen = [], False
    with mitsuba_errors():
        for index in range(frames):
            tracer.set_time(float(index))
            found = np.isfinite(_hits(tracer)[0])
            if not found.any() and not tracer.mi_scene.environment():
                raise SceneError(_nothing(tracer))
            seen = seen or bool(found.any())
            bright.append(_lit(tracer))
        if not seen:
            raise SceneError(_nothing(tracer))
        render_gbuffer(tracer)
    return exposure_from_areas(np.stack(bright))


def exposure_from_areas(areas: Float[Array, "..."]) -> float:
    """What shows luminances of areas at a usual brightness; see `survey`. One must be above 0."""
    average = np.exp(np.log(areas[areas > 0]).mean())
    return float(f"{min(GREY / average, WHITE / np.percentile(areas, 95)):.2g}")


def _hits(tracer: Tracer) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """Of each ray of the grid: the distance to the first surface, and is it met from behind?"""
    import drjit as dr
    import mitsuba as mi

    def look(ray: Any) -> tuple[Any, Any]:
        hit = tracer.mi_scene.ray_intersect_preliminary(ray)
        valid = hit.is_valid()
        if valid is False:
            return np.inf, 0.0
        surface = hit.compute_surface_interaction(ray, active=valid)
        behind = valid & (dr.dot(surface.n, ray.d) > 0)
        return dr.select(valid, hit.t, np.inf), dr.select(behind, mi.Float(1), mi.Float(0))

    step = (np.arange(GRID) + 0.5) / GRID
    across, down = np.meshgrid(step * tracer.width, step * tracer.height)
    lengths, behind = tracer.evaluate_rays(look, np.stack([across.ravel(), down.ravel()], 1))
    return lengths, behind


def _lit(tracer: Tracer) -> Float[Array, " areas"]:
    """Mean luminance of 8 x 8 areas of the picture. Raises SceneError where all of it is black."""
    step = (np.arange(GRID) + 0.5) / GRID
    rows, columns = ((step * side).astype(np.uint32) for side in (tracer.height, tracer.width))
    pixels = (rows[:, None] * np.uint32(tracer.width) + columns).ravel()
    for spp in SPP:
        numbers = np.repeat(np.arange(spp, dtype=np.uint32), len(pixels))
        radiance = tracer.trace(np.tile(pixels, spp), numbers, "pilot")
        luminance = np.nan_to_num(radiance, posinf=0.0) @ [0.2126, 0.7152, 0.0722]
        side = GRID // AREAS
        areas = luminance.reshape(spp, AREAS, side, AREAS, side).mean((0, 2, 4)).ravel()
        if areas.max() > 0:
            return np.asarray(areas)
    lengths, behind = _hits(tracer)
    raise SceneError(
        f"{_camera(tracer)} sees only black: the nearest surface is {lengths.min():.3g} away, and "
        f"{behind.mean():.0%} of what it sees are backs of surfaces. It may be inside a wall or "
        "a closed object, or (as near_clip is ignored) behind one; or no light gets there. Move "
        "it with --camera path.json, or check the lights"
    )


def _nothing(tracer: Tracer) -> str:
    box = tracer.mi_scene.bbox()
    return (
        f"{_camera(tracer)} sees no surface; the scene spans {_told_point(box.min)} to "
        f"{_told_point(box.max)}. Matrices are camera-to-world, and cameras look along +z"
    )


def _camera(tracer: Tracer) -> str:
    place, towards = tracer.pose.camera.origin, tracer.pose.camera_axes()[2]
    return (
        f"frame {tracer.time:.0f}: the camera at {_told_point(place)}, which looks along "
        f"{_told_point(towards)},"
    )


def _told_point(point: Any) -> str:
    return f"({', '.join(f'{float(v):.3g}' for v in point)})"


@contextmanager
def mitsuba_errors() -> Iterator[None]:
    """What Mitsuba refuses, such as spectra that RGB rendering lacks, as SceneError."""
    try:
        yield
    except RuntimeError as error:
        words: list[str] = []
        cause: BaseException | None = error
        while cause is not None:
            words.append(str(cause))
            cause = cause.__cause__ or cause.__context__
        raise SceneError(
            f"Mitsuba cannot trace this scene with {_variant()}: {': '.join(words)}"
        ) from error


def _variant() -> str:
    import mitsuba as mi

    return str(mi.variant())
