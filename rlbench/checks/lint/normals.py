"""Which space normals are in, and how they are encoded."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.finding import Finding, fine, odd, wrong
from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.geometry import KINDS, Fit, positions
from rlbench.ops.reprojection import reproject

CHECK = "normal"
UNIT = 0.02  # how far from 1 a length may be: half precision gives 0.001
MANY = 0.995  # of surface pixels
ALIGNED = math.radians(1.5)  # to axes: what a fit to rendered depth can tell
TURNED = math.radians(0.15)  # of a camera between two frames, that can be told from no turn
POOR = math.radians(8)  # left of the best fit: normals do not follow from depth


def unit(normal: Float[Tensor, "t 3 h w"]) -> Float[Tensor, "t 3 h w"]:
    """Unit length, decoded where encoded, 0 where there is no normal."""
    decoded = 2 * normal - 1 if encoded(normal) else normal
    length = decoded.norm(dim=1, keepdim=True)
    return torch.where(length > 0.1, decoded / length.clamp_min(1e-6), 0.0)


def encoded(normal: Float[Tensor, "t 3 h w"]) -> bool:
    """Do the normals lie in 0..1 with unit length after 2 n - 1?"""
    return float(normal.min()) >= 0 and _share_of_unit(2 * normal - 1) > 0.9


def normals(footage: ClipArrays, fits: dict[str, Fit], upright: bool = True) -> Finding:
    """Are normals in world space, of unit length, 0 for background?

    `fits` are those of `rlbench.checks.lint.geometry.fits`, for this footage; `upright` says that
    the view is not itself mirrored, for then world-space normals must seem to be.
    """
    if "normal" not in footage.gbuffer:
        return odd(CHECK, "the clip has no normal buffer", "write one if a method is to use it")
    stored = footage.gbuffer["normal"]
    if encoded(stored):
        return wrong(CHECK, "encoded in 0..1: 2 n - 1 has unit length", "store 2 n - 1")
    if (share := _share_of_unit(stored)) < MANY:
        told = f"{1 - share:.1%} of the normals are not of unit length"
        return wrong(CHECK, told, "normalise them; do not filter them over pixels")
    if not fits:
        return odd(CHECK, "unit length; no smooth surface shows their space", "check by hand")
    fit = min(fits.values(), key=lambda each: each.left)
    if fit.left > POOR:
        told = f"unit length, but {math.degrees(fit.left):.1f} degrees from those that depth gives"
        return odd(CHECK, told, "check by hand that normal and depth are of the same surface")
    if upright and float(torch.linalg.det(fit.turns).min()) < 0:
        told = "mirrored: only with one axis flipped do they follow from depth"
        return wrong(CHECK, told, "negate the flipped axis; world space is right-handed")
    return _space(footage, fit)


def _space(footage: ClipArrays, fit: Fit) -> Finding:
    aligned = [_to_axes(turn) < ALIGNED for turn in fit.turns]
    if not all(aligned):
        return fine(CHECK, "unit length, in world space: turned against the camera")
    turned = _camera_turns(footage, fit)
    if turned is None or turned < TURNED:
        told = "along the camera's axes, which may be the world's, for it does not turn"
        return odd(CHECK, told, "nothing if the camera looks straight along a world axis")
    told = f"in camera space: they stay along its axes while it turns by {math.degrees(turned):.2f}"
    return wrong(
        CHECK, f"{told} degrees a frame", "rotate them by the camera's matrix to world space"
    )


def _to_axes(turn: Tensor) -> float:
    """Angle to the nearest rotation that takes axes to axes."""
    nearest = torch.zeros_like(turn)
    place = turn.abs().argmax(1)
    nearest[torch.arange(3), place] = turn[torch.arange(3), place].sign()
    cosine = ((nearest * turn).sum() - 1) / 2
    return math.acos(max(-1.0, min(1.0, float(cosine))))


def _camera_turns(footage: ClipArrays, fit: Fit) -> float | None:
    """Radians by which the camera turns between frames, from the points that depth gives."""
    if "motion" not in footage.gbuffer or len(footage) < 2:
        return None
    depth = footage.gbuffer["depth"]
    points = positions(depth.where(depth.isfinite(), 0.0), KINDS[fit.kind], fit.focal)
    found = []
    for index in range(1, len(footage)):
        before, inside = reproject(points[index - 1, None], footage.gbuffer["motion"][index, None])
        some = (inside & footage.solid[index, None])[0, 0]
        here, there = points[index][:, some].T, before[0][:, some].T
        if len(here) < 64:
            continue
        found.append(_rigid(here, there))
    return max(found, default=None)


def _rigid(here: Tensor, there: Tensor) -> float:
    """Angle of the rotation between two clouds of points of which most move together."""
    weight = torch.ones_like(here[:, :1])
    turn = torch.eye(3)
    for _ in range(10):
        middle, middle_there = ((p * weight).sum(0) / weight.sum() for p in (here, there))
        u, _, v = torch.linalg.svd((there - middle_there).T @ ((here - middle) * weight))
        turn = u @ v
        left = ((there - middle_there) - (here - middle) @ turn.T).norm(dim=1, keepdim=True)
        weight = 1 / (1 + (left / left.median().clamp_min(1e-6)).square())
    return math.acos(max(-1.0, min(1.0, (float(turn.trace()) - 1) / 2)))


def _share_of_unit(normal: Tensor) -> float:
    length = normal.norm(dim=1)
    there = length > 1e-3
    if not there.any():
        return 0.0
    return float(((length - 1).abs() < UNIT)[there].float().mean())
