"""All checks of a clip, in the order in which they are printed."""

from __future__ import annotations

import torch

from rlbench.checks.lint.albedo import check_albedo
from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.declared import excuse_declared, without_stand_ins
from rlbench.checks.lint.depth import check_depth
from rlbench.checks.lint.geometry import DepthFit, fit_depth_kinds
from rlbench.checks.lint.motion import check_motion
from rlbench.checks.lint.normals import check_normals, normalize
from rlbench.checks.lint.orientation import (
    check_orientation,
    correlate_orientations,
    misoriented,
    reoriented,
)
from rlbench.checks.lint.reference import check_exposure, check_halves, check_noise_ceiling
from rlbench.checks.lint.samples import (
    check_brightness,
    check_noise_pattern,
    check_samples,
    check_seeds,
)
from rlbench.checks.lint.values import check_finite, check_non_negative
from rlbench.checks.result import CheckResult

__all__ = ["fit_depth", "lint_clip"]

MAX_FRAMES = 3  # frames whose normals are compared with their depth


def lint_clip(arrays: ClipArrays) -> list[CheckResult]:
    """The result of every check of a clip.

    Only the first check reports values that are not finite; all others see 0 in their place. Only
    the orientation check reports flipped pools; checks of the samples see them corrected.

    A buffer that the clip declares to be a stand-in counts as absent. A check that fails for a
    limitation that the clip declares is a warning.
    """
    arrays = without_stand_ins(arrays)
    sanitized = arrays.sanitized
    fits, correlations = fit_depth(sanitized), correlate_orientations(sanitized)
    is_upright = not {"albedo", "normal", "depth"} & set(misoriented(correlations))
    upright = reoriented(sanitized, correlations)
    results = [
        check_finite(arrays),
        check_non_negative(sanitized),
        check_motion(sanitized),
        check_depth(sanitized, fits),
        check_normals(sanitized, fits, is_upright),
        check_albedo(sanitized),
        check_orientation(correlations),
        check_samples(upright),
        check_noise_pattern(upright),
        check_seeds(upright),
        check_brightness(upright),
        check_halves(upright),
        check_noise_ceiling(upright),
        check_exposure(upright),
    ]
    return [excuse_declared(result, arrays.header) for result in results]


def fit_depth(arrays: ClipArrays) -> dict[str, DepthFit]:
    """The kinds of depth that fit the normals, over a few frames; may be empty."""
    if not {"depth", "normal"} <= set(arrays.gbuffer):
        return {}
    frames = torch.linspace(0, len(arrays) - 1, min(MAX_FRAMES, len(arrays))).long()
    depth = arrays.gbuffer["depth"][frames].abs()
    normal = normalize(arrays.gbuffer["normal"][frames])
    return fit_depth_kinds(depth.where(depth > 0, torch.inf), normal)
