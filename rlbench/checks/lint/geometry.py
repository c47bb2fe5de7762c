"""Normals reconstructed from depth, and the rotation from them to the stored normals.

A kind of depth and a focal length place every pixel in camera space; differences between
neighbours there give normals. For the right kind and focal length, one rotation maps them to the
stored normals: the camera's rotation if these are in world space, the identity if not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

VIEW_DEPTH = "distance along the view axis"
FOCAL_LENGTHS = tuple(0.35 * 1.4**i for i in range(7))  # in image widths: 110 to 22 degrees
REFINEMENTS = (0.76, 0.87, 1.15, 1.32)  # times the best of them; then a second, finer round
MAX_PIXELS = 4000  # pixels of a frame that suffice to fit a rotation
MAX_ANGLE = math.radians(20)  # larger angles count as this one
ToViewDepth = Callable[[Tensor, Tensor], Tensor]  # from stored depth and ray length
DEPTH_KINDS: dict[str, ToViewDepth] = {
    VIEW_DEPTH: lambda d, ray: d,
    "distance to the camera": lambda d, ray: d / ray,
    "inverse depth 1 / z": lambda d, ray: 1 / d,
    "logarithmic depth ln(1 + 1 / distance)": lambda d, ray: 1 / torch.expm1(d) / ray,
    "z-buffer (0 near, 1 far)": lambda d, ray: 1 / (1 - d).clamp_min(1e-7),
}


@dataclass(frozen=True)
class DepthFit:
    """How well the stored normals follow from depth of one kind."""

    kind: str
    focal: float  # in image widths
    residual: float  # mean angle between normals after rotation, at most MAX_ANGLE, radians
    rotations: Float[Tensor, "t 3 3"]  # from (right, down, forward) to the stored normals' space


def fit_depth_kinds(
    depth: Float[Tensor, "t 1 h w"], normal: Float[Tensor, "t 3 h w"]
) -> dict[str, DepthFit]:
    """For each kind of depth the fit with the best focal length; empty if no surface is smooth.

    `depth` is > 0, and not finite in the background; `normal` has unit length.
    """
    smooth = _smooth_surface_mask(depth, normal)
    fits = {}
    for kind, to_view_depth in DEPTH_KINDS.items():
        best = None
        for factors in (FOCAL_LENGTHS, REFINEMENTS, [f ** (1 / 3) for f in REFINEMENTS]):
            start = best.focal if best else 1.0
            tried = [_fit(kind, to_view_depth, start * f, depth, normal, smooth) for f in factors]
            usable = [fit for fit in (best, *tried) if fit]
            best = min(usable, key=lambda fit: fit.residual, default=None)
        if best:
            fits[kind] = best
    return fits


def _fit(
    kind: str, to_view_depth: ToViewDepth, focal: float, depth: Tensor, normal: Tensor, mask: Tensor
) -> DepthFit | None:
    if kind.startswith("z-buffer") and bool((depth[depth.isfinite()] > 1).any()):
        return None
    reconstructed = normals_from_depth(depth, to_view_depth, focal)
    rotations, residuals = [], []
    for index in range(len(depth)):
        usable = mask[index, 0] & reconstructed[index].isfinite().all(0)
        if int(usable.sum()) < 64:
            continue
        subset = slice(None, None, -(-int(usable.sum()) // MAX_PIXELS))
        rotation, residual = fit_rotation(
            reconstructed[index][:, usable].T[subset], normal[index][:, usable].T[subset]
        )
        rotations.append(rotation)
        residuals.append(residual)
    if not rotations:
        return None
    return DepthFit(kind, focal, sum(residuals) / len(residuals), torch.stack(rotations))


def normals_from_depth(
    depth: Tensor, to_view_depth: ToViewDepth, focal: float
) -> Float[Tensor, "t 3 h w"]:
    """Unit normals towards the camera by central differences; NaN at the border."""
    points = unproject(depth, to_view_depth, focal)
    across = torch.full_like(points, torch.nan)
    down = torch.full_like(points, torch.nan)
    across[..., 1:-1] = points[..., 2:] - points[..., :-2]
    down[..., 1:-1, :] = points[..., 2:, :] - points[..., :-2, :]
    normal = torch.linalg.cross(across, down, dim=1)
    normal = normal * -(normal * points).sum(1, keepdim=True).sign()
    return torch.nn.functional.normalize(normal, dim=1, eps=1e-30)


def unproject(depth: Tensor, to_view_depth: ToViewDepth, focal: float) -> Float[Tensor, "t 3 h w"]:
    """Each pixel's point in camera space: right, down, forward."""
    h, w = depth.shape[-2:]
    x = ((torch.arange(w) + 0.5 - w / 2) / (focal * w)).to(depth).expand(h, w)
    y = ((torch.arange(h) + 0.5 - h / 2) / (focal * w)).to(depth)[:, None].expand(h, w)
    ray = torch.stack((x, y, torch.ones_like(x)))
    return ray * to_view_depth(depth, ray.norm(dim=0))


def fit_rotation(
    source: Float[Tensor, "p 3"], target: Float[Tensor, "p 3"]
) -> tuple[Float[Tensor, "3 3"], float]:
    """The orthogonal matrix from source to target unit vectors, and the mean remaining angle.

    Kabsch 1976 with iterative reweighting, so that bumps and edges have little influence. A
    reflection is allowed, because a flipped axis looks like one. Angles are capped at MAX_ANGLE.
    """
    source, target = source.double(), target.double()
    weight = torch.ones_like(source[:, 0])
    matrix = torch.eye(3).double()
    angle = weight
    for _ in range(6):
        u, _, v = torch.linalg.svd((target * weight[:, None]).T @ source)
        matrix = u @ v
        angle = (target - source @ matrix.T).norm(dim=1)
        weight = 1 / (1 + (angle / 0.05).square())
    return matrix.float(), float(angle.clamp_max(MAX_ANGLE).mean())


def _smooth_surface_mask(depth: Tensor, normal: Tensor) -> Bool[Tensor, "t 1 h w"]:
    """Where all four neighbours lie on the same smooth surface: depth and normal vary little."""
    mask = torch.zeros_like(depth, dtype=torch.bool)
    centre = depth[..., 1:-1, 1:-1]
    smooth = centre.isfinite() & (centre != 0)
    centre_normal = normal[..., 1:-1, 1:-1]
    for dy, dx in ((0, 1), (1, 0)):
        h, w = depth.shape[-2:]
        before = (slice(1 - dy, h - 1 - dy), slice(1 - dx, w - 1 - dx))
        after = (slice(1 + dy, h - 1 + dy), slice(1 + dx, w - 1 + dx))
        one, two = depth[..., *before], depth[..., *after]
        smooth = smooth & ((one + two - 2 * centre).abs() < 0.02 * centre.abs())
        for region in (before, after):
            cosine = (normal[..., *region] * centre_normal).sum(1, keepdim=True)
            smooth = smooth & (cosine > 0.98)
    mask[..., 1:-1, 1:-1] = smooth
    return mask
