"""Normals: are they in world space, of unit length, and not encoded?"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.geometry import DEPTH_KINDS, DepthFit, unproject
from rlbench.checks.result import CheckResult, failed, passed, warning
from rlbench.ops.reprojection import reproject

CHECK = "normal"
UNIT_TOLERANCE = 0.02  # deviation of a length from 1; half precision causes 0.001
MIN_UNIT_SHARE = 0.995  # of surface pixels with unit length
ALIGNED = math.radians(1.5)  # to the axes: accuracy of a fit to rendered depth
MIN_TURN = math.radians(0.15)  # of a camera between two frames, that differs measurably from none
MAX_RESIDUAL = math.radians(8)  # of the best fit, above which normals do not follow from depth


def normalize(normal: Float[Tensor, "t 3 h w"]) -> Float[Tensor, "t 3 h w"]:
    """Normals of unit length, decoded if encoded, 0 where there is no normal."""
    decoded = 2 * normal - 1 if is_encoded(normal) else normal
    length = decoded.norm(dim=1, keepdim=True)
    return torch.where(length > 0.1, decoded / length.clamp_min(1e-6), 0.0)


def is_encoded(normal: Float[Tensor, "t 3 h w"]) -> bool:
    """Do the normals lie in [0, 1], with unit length after 2 n - 1?"""
    return float(normal.min()) >= 0 and _unit_share(2 * normal - 1) > 0.9


def check_normals(
    arrays: ClipArrays, fits: dict[str, DepthFit], is_upright: bool = True
) -> CheckResult:
    """Are normals in world space, of unit length, and 0 in the background?

    `fits` is the result of `rlbench.checks.lint.checks.fit_depth` for these arrays. Where the
    G-buffer is flipped (`is_upright` is False), world-space normals look mirrored and are accepted.
    """
    if "normal" not in arrays.gbuffer:
        return warning(
            CHECK, "the clip has no normal buffer", "write one if a method needs it as input"
        )
    normal = arrays.gbuffer["normal"]
    if is_encoded(normal):
        found = "encoded in [0, 1]: 2 n - 1 has unit length"
        return failed(CHECK, found, "store 2 n - 1")
    if (share := _unit_share(normal)) < MIN_UNIT_SHARE:
        found = f"expected unit length, found another in {1 - share:.1%} of the normals"
        return failed(CHECK, found, "normalise them; do not filter them over pixels")
    if not fits:
        found = "unit length; no smooth surface to determine their space"
        return warning(CHECK, found, "compare with the renderer's documentation")
    fit = min(fits.values(), key=lambda each: each.residual)
    if fit.residual > MAX_RESIDUAL:
        angle = f"{math.degrees(fit.residual):.1f} degrees"
        found = f"unit length, but they deviate by {angle} from normals computed from depth"
        return warning(CHECK, found, "check that normal and depth show the same surface")
    if is_upright and float(torch.linalg.det(fit.rotations).min()) < 0:
        found = "mirrored: they follow from depth only with one axis flipped"
        return failed(CHECK, found, "negate the flipped axis; world space is right-handed")
    return _check_space(arrays, fit)


def _check_space(arrays: ClipArrays, fit: DepthFit) -> CheckResult:
    if not all(_angle_to_axes(rotation) < ALIGNED for rotation in fit.rotations):
        return passed(CHECK, "unit length, in world space: rotated relative to the camera")
    turn = _max_camera_turn(arrays, fit)
    if turn is None or turn < MIN_TURN:
        found = "along the camera's axes, which may be the world's, because the camera never turns"
        remedy = "ignore this if the camera looks straight along a world axis"
        return warning(CHECK, found, remedy)
    found = (
        "in camera space: they stay along the camera's axes while it turns by "
        f"{math.degrees(turn):.2f} degrees per frame"
    )
    return failed(CHECK, found, "rotate them to world space by the camera's matrix")


def _angle_to_axes(rotation: Tensor) -> float:
    """Angle to the nearest rotation that maps axes to axes."""
    nearest = torch.zeros_like(rotation)
    largest = rotation.abs().argmax(1)
    nearest[torch.arange(3), largest] = rotation[torch.arange(3), largest].sign()
    cosine = ((nearest * rotation).sum() - 1) / 2
    return math.acos(max(-1.0, min(1.0, float(cosine))))


def _max_camera_turn(arrays: ClipArrays, fit: DepthFit) -> float | None:
    """Largest rotation of the camera between two frames, in radians, from depth and motion."""
    if "motion" not in arrays.gbuffer or len(arrays) < 2:
        return None
    depth = arrays.gbuffer["depth"]
    points = unproject(depth.where(depth.isfinite(), 0.0), DEPTH_KINDS[fit.kind], fit.focal)
    turns = []
    for index in range(1, len(arrays)):
        motion = arrays.gbuffer["motion"][index, None]
        previous, inside = reproject(points[index - 1, None], motion)
        mask = (inside & arrays.surface_mask[index, None])[0, 0]
        current, before = points[index][:, mask].T, previous[0][:, mask].T
        if len(current) < 64:
            continue
        turns.append(_rotation_angle(current, before))
    return max(turns, default=None)


def _rotation_angle(source: Tensor, target: Tensor) -> float:
    """Angle of the rotation between two point clouds, most of which move rigidly."""
    weight = torch.ones_like(source[:, :1])
    matrix = torch.eye(3)
    for _ in range(10):
        centre, target_centre = ((p * weight).sum(0) / weight.sum() for p in (source, target))
        u, _, v = torch.linalg.svd((target - target_centre).T @ ((source - centre) * weight))
        matrix = u @ v
        residual = (target - target_centre) - (source - centre) @ matrix.T
        distance = residual.norm(dim=1, keepdim=True)
        weight = 1 / (1 + (distance / distance.median().clamp_min(1e-6)).square())
    return math.acos(max(-1.0, min(1.0, (float(matrix.trace()) - 1) / 2)))


def _unit_share(normal: Tensor) -> float:
    """Share of the normals, where there is one, that have unit length."""
    length = normal.norm(dim=1)
    has_normal = length > 1e-3
    if not has_normal.any():
        return 0.0
    return float(((length - 1).abs() < UNIT_TOLERANCE)[has_normal].float().mean())
