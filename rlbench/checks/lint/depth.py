"""Depth: is it distance along the view axis, linear, with +inf as background?"""

from __future__ import annotations

import math

import torch

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.geometry import VIEW_DEPTH, DepthFit
from rlbench.checks.lint.normals import normalize
from rlbench.checks.result import CheckResult, failed, passed, warning

CHECK = "depth"
MARGIN = 0.8  # a kind fits clearly better if its residual is below this share of the other's
FAR = 1e9  # what renderers write for background if not infinity


def check_depth(arrays: ClipArrays, fits: dict[str, DepthFit]) -> CheckResult:
    """Is depth linear, along the view axis, and +inf in the background?

    `fits` is the result of `rlbench.checks.lint.checks.fit_depth` for these arrays.
    """
    if "depth" not in arrays.gbuffer:
        return warning(
            CHECK, "the clip has no depth buffer", "write one if a method needs it as input"
        )
    depth = arrays.gbuffer["depth"]
    finite = depth[depth.isfinite()]
    if not len(finite) or float(finite.max()) <= 0:
        return failed(
            CHECK, "no pixel has a depth above 0", "write distance along the view axis, > 0"
        )
    if (share := float((finite < 0).float().mean())) > 0:
        remedy = "negate it if the camera looks along -z; nothing lies behind the camera"
        return failed(CHECK, f"expected values > 0, found {share:.1%} of pixels negative", remedy)
    if fault := _find_background_fault(arrays):
        return failed(CHECK, fault, "write +inf where no surface is visible, and only there")
    maxima = torch.stack([d[d.isfinite()].amax() for d in depth if d.isfinite().any()])
    if bool(((maxima - 1).abs() < 2e-3).all()):
        found = "the largest depth of every frame is 1, so it is normalised"
        return failed(CHECK, found, "store it in scene units, linear")
    return _check_kind(fits, f"{float(finite.min()):.3g} to {float(finite.max()):.3g}")


def _check_kind(fits: dict[str, DepthFit], span: str) -> CheckResult:
    if VIEW_DEPTH not in fits:
        found = f"{span}; no smooth surface to determine the kind of depth"
        return warning(CHECK, found, "compare with the renderer's documentation")
    stored = fits[VIEW_DEPTH]
    rival = min(
        (fit for kind, fit in fits.items() if kind != VIEW_DEPTH), key=lambda fit: fit.residual
    )
    found = (
        f"deviates from the normals by {_degrees(stored.residual)} as {VIEW_DEPTH}, "
        f"by {_degrees(rival.residual)} as {rival.kind}"
    )
    if rival.residual < MARGIN * stored.residual:
        return failed(CHECK, found, f"convert it from {rival.kind} to {VIEW_DEPTH}")
    if stored.residual > MARGIN * rival.residual:
        remedy = "compare with the renderer's documentation"
        return warning(CHECK, f"{found}; too similar to decide", remedy)
    field_of_view = 2 * math.degrees(math.atan(0.5 / stored.focal))
    return passed(CHECK, f"{span}; {found}; field of view about {field_of_view:.0f} degrees")


def _find_background_fault(arrays: ClipArrays) -> str:
    """The fault of the background, or an empty string."""
    depth = arrays.gbuffer["depth"]
    if share := float((depth == 0).float().mean()):
        return f"depth is 0 in {share:.1%} of pixels"
    if share := float((depth.isfinite() & (depth > FAR)).float().mean()):
        return f"depth is {float(depth[depth.isfinite()].max()):.3g} in {share:.1%} of pixels"
    if "normal" in arrays.gbuffer:
        empty = normalize(arrays.gbuffer["normal"]).norm(dim=1, keepdim=True) < 0.5
        share = float((empty != depth.isposinf()).float().mean())
        if share > 1e-3:
            return f"depth and normal disagree on what is background in {share:.1%} of pixels"
    return ""


def _degrees(radians: float) -> str:
    return f"{math.degrees(radians):.1f} degrees"
