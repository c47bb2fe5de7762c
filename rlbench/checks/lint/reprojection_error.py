"""How much of the change between two frames a motion buffer explains, in one convention."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.motion_conventions import DIRECTIONS, MotionConvention
from rlbench.ops.reprojection import reproject

FLOOR = 0.01  # standard deviations: smaller differences are rounding and interpolation


def explained_change(
    arrays: ClipArrays, convention: MotionConvention, frames: Sequence[int]
) -> Float[Tensor, " pairs"]:
    """Share of the change between two frames that a convention explains, at each of `frames`.

    The change is the sum over pixels of the logarithm of the difference in albedo, normal and
    depth, down to the floor: 1 where the reprojected frame equals the other, 0 where it is no
    better than without motion, below 0 where it is worse. The logarithm keeps a disoccluded pixel
    from outweighing one that fits. Motion that points outside the image explains nothing.
    Background is left out: it has nothing to compare, and where an object hid it, it would count
    against any motion except zero.
    """
    shares, offset = [], DIRECTIONS[convention.direction]
    features = _features(arrays)
    for index in frames:
        motion = convention.to_pixels(arrays.gbuffer["motion"][index, None])
        current, other = features[index, None], features[index + offset, None]
        still, _ = _log_difference(current, other, torch.zeros_like(motion))
        reprojected, valid = _log_difference(current, other, motion)
        surface = (current != 0).any(1, keepdim=True)
        explained = ((still - reprojected) * (valid & surface)).sum()
        shares.append(explained / (still * surface).sum().clamp_min(1e-9))
    return torch.stack(shares)


def _features(arrays: ClipArrays) -> Float[Tensor, "t 7 h w"]:
    """Albedo and normal, scaled to standard deviation 1, and disparity; 0 for absent buffers."""
    like, gbuffer = arrays.half_a, arrays.gbuffer
    images = [gbuffer.get(name, torch.zeros_like(like)) for name in ("albedo", "normal")]
    images = [image / image.std().clamp_min(1e-6) for image in images]
    depth = gbuffer.get("depth", torch.full_like(like[:, :1], torch.inf))
    return torch.cat([*images, 1 / depth.abs().clamp_min(1e-6)], 1)


def _log_difference(
    current: Float[Tensor, "1 7 h w"],
    other: Float[Tensor, "1 7 h w"],
    motion: Float[Tensor, "1 2 h w"],
) -> tuple[Float[Tensor, "1 1 h w"], Bool[Tensor, "1 1 h w"]]:
    """Mean over the buffers of log(1 + difference / floor), and where motion stays inside.

    The difference is that to the reprojected frame, or to the most similar of its four taps:
    between the taps of an edge, interpolation gives a mixture that neither frame shows.
    """
    reprojected, inside = reproject(other, motion)
    disparity = current[:, 6:]
    scale = _disparity_scale(disparity, reprojected[:, 6:], inside)
    current = torch.cat((current[:, :6], disparity * scale), 1)
    least = _differences(current, reprojected)
    for x, y in product((torch.floor, torch.ceil), (torch.floor, torch.ceil)):
        tap, valid = reproject(other, torch.stack((x(motion[:, 0]), y(motion[:, 1])), 1))
        least = torch.where(valid, least.minimum(_differences(current, tap)), least)
    return (least / FLOOR).log1p().mean(1, keepdim=True), inside


def _differences(current: Tensor, other: Tensor) -> Float[Tensor, "1 3 h w"]:
    """Differences of albedo, normal and disparity, the last relative to the larger one.

    Where either is background, whose disparity is 0, the relative difference is 1.
    """
    difference = (current - other).abs()
    larger = torch.maximum(current[:, 6], other[:, 6]).clamp_min(1e-9)
    parts = (difference[:, :3].mean(1), difference[:, 3:6].mean(1), difference[:, 6] / larger)
    return torch.stack(parts, 1)


def _disparity_scale(current: Tensor, reprojected: Tensor, inside: Tensor) -> Tensor:
    """[1 1 h w] Factor from the disparity in one camera pose to that in the other.

    A static point at (x z, y z, z) has depth a x z + b y z + c z + d in another pose, whatever the
    camera: so the ratio of depths is fitted by a x + b y + c + d / z. Disparity 1 / z is
    interpolated because it is linear in the image on planes.
    """
    h, w = current.shape[-2:]
    mask = ((current > 0) & (reprojected > 0) & inside)[0, 0]
    x = torch.linspace(-1, 1, w).expand(h, w)
    y = torch.linspace(-1, 1, h)[:, None].expand(h, w)
    relative = current[0, 0] / current.mean().clamp_min(1e-9)
    terms = torch.stack((x, y, torch.ones_like(x), relative), -1)
    subset = terms[mask][::7].double()
    if len(subset) < 16:
        return torch.ones_like(current)
    target = (current / reprojected)[0, 0][mask][::7].double()
    ratio = (terms @ _fit_robustly(subset, target).float())[None, None]
    scale: Tensor = ratio.clamp(0.1, 10).reciprocal()
    return scale


def _fit_robustly(terms: Float[Tensor, "p 4"], target: Float[Tensor, " p"]) -> Float[Tensor, "4"]:
    """Coefficients of a least-squares fit, reweighted by Cauchy's weights."""
    coefficients = torch.zeros(4).double()
    residual = (target - target.median()).abs()
    for _ in range(6):
        weight = 1 / (1 + (residual / residual.median().clamp_min(1e-4)).square())
        gram = terms.T @ (terms * weight[:, None])
        ridge = 1e-9 * gram.trace() * torch.eye(4).double()
        coefficients = torch.linalg.solve(gram + ridge, terms.T @ (weight * target))
        residual = (terms @ coefficients - target).abs()
    return coefficients
