"""Normals that follow from depth, and the rotation from them to the stored ones.

Depth of any kind and a focal length place every pixel in the camera's space; differences between
neighbours there are normals. Of the right kind and focal length, one rotation takes them to the
stored normals: that of the camera, if these are in world space, and none, if they are not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

VIEW = "view depth, along the axis"
FOCALS = tuple(0.35 * 1.4**i for i in range(7))  # in image widths: views of 110 to 22 degrees
FINER = (0.76, 0.87, 1.15, 1.32)  # times the best of them, and once more, a third as far
MOST = 4000  # pixels of a frame that are enough to find a rotation
CUT = math.radians(20)  # angle from which on all normals count alike
Point = Callable[[Tensor, Tensor], Tensor]  # depth along the axis, from stored depth and ray length
KINDS: dict[str, Point] = {
    VIEW: lambda d, ray: d,
    "distance to the eye": lambda d, ray: d / ray,
    "inverse depth, 1 / z": lambda d, ray: 1 / d,
    "logarithmic, ln(1 + 1 / distance)": lambda d, ray: 1 / torch.expm1(d) / ray,
    "z-buffer, 0 near and 1 far": lambda d, ray: 1 / (1 - d).clamp_min(1e-7),
}


@dataclass(frozen=True)
class Fit:
    """How well the stored normals follow from depth, read in one way."""

    kind: str
    focal: float  # in image widths
    left: float  # mean angle that is left, cut at CUT, radians
    turns: Float[Tensor, "t 3 3"]  # from (right, down, forward) to the stored normals' space


def fits(depth: Float[Tensor, "t 1 h w"], normal: Float[Tensor, "t 3 h w"]) -> dict[str, Fit]:
    """For each kind of depth the focal length that fits best, by kind; empty where none is usable.

    `depth` is > 0, and not finite where there is background; `normal` is unit length.
    """
    some = _smooth(depth, normal)
    found = {}
    for kind, place in KINDS.items():
        best = None
        for factors in (FOCALS, FINER, [factor ** (1 / 3) for factor in FINER]):
            around = best.focal if best else 1.0
            tried = [_fit(kind, place, around * f, depth, normal, some) for f in factors]
            each = [fit for fit in (best, *tried) if fit]
            best = min(each, key=lambda fit: fit.left, default=None)
        if best:
            found[kind] = best
    return found


def _fit(
    kind: str, place: Point, focal: float, depth: Tensor, normal: Tensor, some: Tensor
) -> Fit | None:
    if kind.startswith("z-buffer") and bool((depth[depth.isfinite()] > 1).any()):
        return None
    facing = geometric(depth, place, focal)
    turns, lefts = [], []
    for index in range(len(depth)):
        mask = some[index, 0] & facing[index].isfinite().all(0)
        if int(mask.sum()) < 64:
            continue
        few = slice(None, None, -(-int(mask.sum()) // MOST))
        turn, left = rotation(facing[index][:, mask].T[few], normal[index][:, mask].T[few])
        turns.append(turn)
        lefts.append(left)
    if not turns:
        return None
    return Fit(kind, focal, sum(lefts) / len(lefts), torch.stack(turns))


def geometric(depth: Tensor, place: Point, focal: float) -> Float[Tensor, "t 3 h w"]:
    """Unit normals towards the camera by central differences; NaN at the border."""
    points = positions(depth, place, focal)
    across = torch.full_like(points, torch.nan)
    down = torch.full_like(points, torch.nan)
    across[..., 1:-1] = points[..., 2:] - points[..., :-2]
    down[..., 1:-1, :] = points[..., 2:, :] - points[..., :-2, :]
    normal = torch.linalg.cross(across, down, dim=1)
    normal = normal * -(normal * points).sum(1, keepdim=True).sign()
    return torch.nn.functional.normalize(normal, dim=1, eps=1e-30)


def positions(depth: Tensor, place: Point, focal: float) -> Float[Tensor, "t 3 h w"]:
    """Each pixel's point in the camera's space: right, down, forward."""
    h, w = depth.shape[-2:]
    x = ((torch.arange(w) + 0.5 - w / 2) / (focal * w)).to(depth).expand(h, w)
    y = ((torch.arange(h) + 0.5 - h / 2) / (focal * w)).to(depth)[:, None].expand(h, w)
    ray = torch.stack((x, y, torch.ones_like(x)))
    return ray * place(depth, ray.norm(dim=0))


def rotation(
    source: Float[Tensor, "p 3"], target: Float[Tensor, "p 3"]
) -> tuple[Float[Tensor, "3 3"], float]:
    """The orthogonal matrix from unit vectors to others, and the mean angle left, cut at CUT.

    Kabsch 1976 in rounds of reweighting, so that bumps and edges count little; a mirroring is
    allowed, for it is what a flipped axis looks like.
    """
    source, target = source.double(), target.double()
    weight = torch.ones_like(source[:, 0])
    turn = torch.eye(3).double()
    angle = weight
    for _ in range(6):
        u, _, v = torch.linalg.svd((target * weight[:, None]).T @ source)
        turn = u @ v
        angle = (target - source @ turn.T).norm(dim=1)
        weight = 1 / (1 + (angle / 0.05).square())
    return turn.float(), float(angle.clamp_max(CUT).mean())


def _smooth(depth: Tensor, normal: Tensor) -> Bool[Tensor, "t 1 h w"]:
    """Where all four neighbours are of the same smooth surface: depth bends little, normals too."""
    some = torch.zeros_like(depth, dtype=torch.bool)
    here = depth[..., 1:-1, 1:-1]
    smooth = here.isfinite() & (here != 0)
    own = normal[..., 1:-1, 1:-1]
    for dy, dx in ((0, 1), (1, 0)):
        h, w = depth.shape[-2:]
        before = (slice(1 - dy, h - 1 - dy), slice(1 - dx, w - 1 - dx))
        after = (slice(1 + dy, h - 1 + dy), slice(1 + dx, w - 1 + dx))
        one, two = depth[..., *before], depth[..., *after]
        smooth = smooth & ((one + two - 2 * here).abs() < 0.02 * here.abs())
        for place in (before, after):
            smooth = smooth & ((normal[..., *place] * own).sum(1, keepdim=True) > 0.98)
    some[..., 1:-1, 1:-1] = smooth
    return some
