"""Which kind of depth it is: along the axis, to the eye, inverse, normalised; its background."""

from __future__ import annotations

import math

import torch

from rlbench.checks.finding import Finding, fine, odd, wrong
from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.geometry import VIEW, Fit
from rlbench.checks.lint.normals import unit

CHECK = "depth"
CLEARLY = 0.8  # times the best of other kinds: what is left of one that fits clearly better
FAR = 1e9  # what renderers write for background that is not infinite


def depth(footage: ClipArrays, fits: dict[str, Fit]) -> Finding:
    """Is depth linear, along the view axis, and +inf where there is nothing?

    `fits` are those of `rlbench.checks.lint.geometry.fits`, for this footage.
    """
    if "depth" not in footage.gbuffer:
        return odd(CHECK, "the clip has no depth buffer", "write one if a method is to use it")
    stored = footage.gbuffer["depth"]
    seen = stored[stored.isfinite()]
    if not len(seen) or float(seen.max()) <= 0:
        return wrong(
            CHECK, "no pixel has a depth above 0", "write distance along the view axis, > 0"
        )
    if float((seen < 0).float().mean()) > 0:
        told = f"{(seen < 0).float().mean():.1%} of pixels are negative"
        return wrong(CHECK, told, "negate it if the camera looks along -z; nothing is behind it")
    if told := _background(footage):
        return wrong(CHECK, told, "write +inf where no surface is seen, and only there")
    top = torch.stack([d[d.isfinite()].amax() for d in stored if d.isfinite().any()])
    if bool(((top - 1).abs() < 2e-3).all()):
        told = "the largest depth of every frame is 1, so it is normalised"
        return wrong(CHECK, told, "store it in scene units, linear")
    return _kind(fits, f"{float(seen.min()):.3g} to {float(seen.max()):.3g}")


def _kind(fits: dict[str, Fit], span: str) -> Finding:
    if VIEW not in fits:
        return odd(CHECK, f"{span}; no smooth surface shows its kind", "nothing, or check by hand")
    stored = fits[VIEW]
    others = [fit for kind, fit in fits.items() if kind != VIEW]
    rival = min(others, key=lambda fit: fit.left)
    told = f"{_angle(stored.left)} to the normals as {VIEW}; {_angle(rival.left)} as {rival.kind}"
    if rival.left < CLEARLY * stored.left:
        return wrong(CHECK, told, f"convert it from {rival.kind} to {VIEW}")
    if stored.left > CLEARLY * rival.left:
        return odd(CHECK, f"{told}; too alike to tell", "nothing, or check by hand")
    field_of_view = 2 * math.degrees(math.atan(0.5 / stored.focal))
    return fine(CHECK, f"{span}; {told}; field of view about {field_of_view:.0f} degrees")


def _background(footage: ClipArrays) -> str:
    """What is odd about it, or nothing."""
    stored = footage.gbuffer["depth"]
    if share := float((stored == 0).float().mean()):
        return f"depth is 0 in {share:.1%} of pixels"
    if share := float((stored.isfinite() & (stored > FAR)).float().mean()):
        return f"depth is {float(stored[stored.isfinite()].max()):.3g} in {share:.1%} of pixels"
    if "normal" in footage.gbuffer:
        empty = unit(footage.gbuffer["normal"]).norm(dim=1, keepdim=True) < 0.5
        share = float((empty != stored.isposinf()).float().mean())
        if share > 1e-3:
            return f"depth and normal disagree in {share:.1%} of pixels on what is background"
    return ""


def _angle(radians: float) -> str:
    return f"{math.degrees(radians):.1f} degrees"
