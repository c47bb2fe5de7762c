"""Which reading of the motion buffer moves one frame onto the next."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.checks.finding import Finding, fine, odd, wrong
from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.motion_conventions import (
    DIRECTIONS,
    OPPOSITE,
    STORED,
    MotionConvention,
    readings,
)
from rlbench.ops.reprojection import reproject

CHECK = "motion"
FLOOR = 0.01  # standard deviations: differences below it are rounding and interpolation
PAIRS = 3  # pairs of frames on which the likely readings are tried
KEPT = 8  # likely readings
STILL = 1e-3  # mean change of the view, in standard deviations, below which nothing moves
NOTHING = 0.05  # of the change: what explains less does not fit at all
TIE = 0.04  # of the change: readings that differ less fit alike; measured: at most 0.034 on ours
CUT = 0.3  # times the median: a frame that is explained less is as after a cut
TWIN = 0.12  # the same for the opposite way, which differs by acceleration and what is hidden only


def explained(
    footage: ClipArrays, reading: MotionConvention, frames: Sequence[int]
) -> Float[Tensor, " pairs"]:
    """Share of the change between two frames that a reading explains, at each of `frames`.

    The change is the sum over pixels of the logarithm of the difference in albedo, normal and
    depth, down to the floor: 1 where the moved picture equals the other, 0 where it is no better
    than without motion, below 0 where it is worse. Logarithms, so that a pixel that was hidden
    weighs no more than one that fits. Motion that leads outside the image explains nothing. Of
    background there is nothing to compare, and what an object hid of it would tell against any
    motion that is more than none: it is left out.
    """
    shares, step = [], DIRECTIONS[reading.direction]
    pictures = _pictures(footage)
    for index in frames:
        motion = reading.pixels(footage.gbuffer["motion"][index, None])
        now, other = pictures[index, None], pictures[index + step, None]
        still, _ = _doubt(now, other, torch.zeros_like(motion))
        moved, valid = _doubt(now, other, motion)
        seen = (now != 0).any(1, keepdim=True)
        shares.append(
            ((still - moved) * (valid & seen)).sum() / (still * seen).sum().clamp_min(1e-9)
        )
    return torch.stack(shares)


def _pictures(footage: ClipArrays) -> Float[Tensor, "t 7 h w"]:
    """Albedo and normal, each with standard deviation 1, and disparity; 0 for what is not there."""
    like, gbuffer = footage.half_a, footage.gbuffer
    found = [gbuffer.get(name, torch.zeros_like(like)) for name in ("albedo", "normal")]
    found = [image / image.std().clamp_min(1e-6) for image in found]
    depth = gbuffer.get("depth", torch.full_like(like[:, :1], torch.inf))
    return torch.cat([*found, 1 / depth.abs().clamp_min(1e-6)], 1)


def _doubt(
    now: Float[Tensor, "1 7 h w"], other: Float[Tensor, "1 7 h w"], motion: Float[Tensor, "1 2 h w"]
) -> tuple[Float[Tensor, "1 1 h w"], Bool[Tensor, "1 1 h w"]]:
    """Mean over the buffers of log(1 + difference / floor), and where motion stays inside.

    The difference is that to the moved picture, or to the most alike of its four taps: between the
    taps of an edge lies a mixture that neither picture shows.
    """
    moved, inside = reproject(other, motion)
    near = now[:, 6:]
    now = torch.cat((now[:, :6], near * _approach(near, moved[:, 6:], inside)), 1)
    least = _differences(now, moved)
    for x, y in product((torch.floor, torch.ceil), (torch.floor, torch.ceil)):
        tap, valid = reproject(other, torch.stack((x(motion[:, 0]), y(motion[:, 1])), 1))
        least = torch.where(valid, least.minimum(_differences(now, tap)), least)
    return (least / FLOOR).log1p().mean(1, keepdim=True), inside


def _differences(now: Tensor, other: Tensor) -> Float[Tensor, "1 3 h w"]:
    """Of albedo, normal and disparity, the last as a share of the larger one.

    Where one is background, whose disparity is 0, the share is 1, whichever of the two it is.
    """
    apart = (now - other).abs()
    larger = torch.maximum(now[:, 6], other[:, 6]).clamp_min(1e-9)
    parts = (apart[:, :3].mean(1), apart[:, 3:6].mean(1), apart[:, 6] / larger)
    return torch.stack(parts, 1)


def _approach(now: Tensor, moved: Tensor, inside: Tensor) -> Tensor:
    """[1 1 h w] By what disparity must be multiplied to become that of the other pose's camera.

    A static point at (x z, y z, z) has depth a x z + b y z + c z + d in another pose, whatever the
    camera: so the ratio of depths is fitted by a x + b y + c + d / z. Disparity 1 / z is what is
    interpolated, for on planes it is linear in the image.
    """
    h, w = now.shape[-2:]
    some = ((now > 0) & (moved > 0) & inside)[0, 0]
    x = torch.linspace(-1, 1, w).expand(h, w)
    y = torch.linspace(-1, 1, h)[:, None].expand(h, w)
    terms = torch.stack((x, y, torch.ones_like(x), now[0, 0] / now.mean().clamp_min(1e-9)), -1)
    few = terms[some][::7].double()
    if len(few) < 16:
        return torch.ones_like(now)
    wanted = (now / moved)[0, 0][some][::7].double()
    left = (wanted - wanted.median()).abs()
    for _ in range(6):  # rounds of reweighting by Cauchy's weights, in units of the median
        weight = 1 / (1 + (left / left.median().clamp_min(1e-4)).square())
        gram = few.T @ (few * weight[:, None])
        ridge = 1e-9 * gram.trace() * torch.eye(4).double()
        found = torch.linalg.solve(gram + ridge, few.T @ (weight * wanted))
        left = (few @ found - wanted).abs()
    ratio = (terms @ found.float())[None, None]
    inverse: Tensor = ratio.clamp(0.1, 10).reciprocal()
    return inverse


def best(footage: ClipArrays) -> list[tuple[MotionConvention, float]]:
    """Likely readings with the mean share that they explain, the best first; v1's wins ties.

    All are tried on one pair of frames of a shot, and those that do well there on up to PAIRS.
    """
    follow = _follow(footage)
    middle = [t for t in follow if t + 1 in follow] or follow

    def tried(
        some: Sequence[MotionConvention], frames: Sequence[int]
    ) -> list[tuple[MotionConvention, float]]:
        found = []
        for reading in some:
            fitting = [t for t in frames if t + max(DIRECTIONS[reading.direction], 0) in follow]
            if fitting:
                found.append((reading, float(explained(footage, reading, fitting).mean())))
        return sorted(found, key=lambda pair: (-pair[1], pair[0] != STORED))

    first = [reading for reading, _ in tried(readings(), middle[len(middle) // 2 :][:1])]
    kept = list(dict.fromkeys([STORED, *first[:KEPT]]))
    return tried(kept, middle[:: -(-len(middle) // PAIRS)])


def motion(footage: ClipArrays) -> Finding:
    """Does motion lead to where a pixel was in the previous frame, and does nothing else fit?"""
    if early := _early(footage):
        return early
    found = best(footage)
    stored = dict(found)[STORED]
    (rival, share), *_ = found
    margin = TWIN if rival == OPPOSITE else TIE
    other = next(f"{s:.0%} by {r}" for r, s in found if r not in (STORED, OPPOSITE))
    if share - stored > margin:
        told = f"{share:.0%} of the change is explained as {rival}; {stored:.0%} as {STORED}"
        return wrong(CHECK, told, f"convert it from {rival}")
    if stored < NOTHING:
        told = f"it explains {stored:.0%} of the change between frames; nothing does better"
        return wrong(CHECK, told, "check which frames and which camera the motion is from")
    told = f"explains {stored:.0%} of the change as {STORED}; next best {other}"
    each = explained(footage, STORED, _follow(footage))
    if float(each.min()) < CUT * float(each.median()):
        frame = _follow(footage)[int(each.argmin())]
        remedy = "if another shot begins there, list it in cuts, and let motion lead outside"
        return odd(CHECK, f"{told}; but {each.min():.0%} in frame {frame}", remedy)
    return fine(CHECK, told)


def moves(footage: ClipArrays) -> float:
    """Mean difference between neighbouring frames of the view, in standard deviations, cut at 1.

    Neighbours are those of one shot.
    """
    follow = torch.tensor(_follow(footage), dtype=torch.long)
    views = [v for name, v in footage.gbuffer.items() if name in ("albedo", "normal")]
    views += [1 / footage.gbuffer["depth"]] if "depth" in footage.gbuffer else []
    spread = [(v[follow] - v[follow - 1]).abs() / v.std().clamp_min(1e-6) for v in views]
    return max((float(s.clamp_max(1).mean()) for s in spread), default=0.0)


def _early(footage: ClipArrays) -> Finding | None:
    """What is told without trying any reading, if there is something."""
    if footage.header.static:
        return _static(footage)
    if "motion" not in footage.gbuffer:
        return odd(CHECK, "the clip has no motion buffer", "write one, or say static = true")
    if told := _cuts(footage):
        return wrong(CHECK, told, "let motion lead outside there, as history is of another shot")
    if not _follow(footage):
        return odd(CHECK, "no frame has a previous one of its shot", "lint at least two frames")
    if moves(footage) < STILL:
        return odd(CHECK, "nothing moves, so no reading can be told", "say static = true")
    return None


def _follow(footage: ClipArrays) -> list[int]:
    """Frames that are of the same shot as the frame before."""
    return [t for t in range(1, len(footage)) if t not in footage.header.cuts]


def _cuts(footage: ClipArrays) -> str:
    """Which cut has motion that leads into the previous shot, or nothing."""
    for index in (cut for cut in footage.header.cuts if cut < len(footage)):
        motion = footage.gbuffer["motion"][index, None]
        inside = float(reproject(torch.zeros_like(motion), motion)[1].float().mean())
        if inside > 0:
            return f"frame {index} is a cut, but motion of {inside:.1%} of it leads inside"
    return ""


def _static(footage: ClipArrays) -> Finding:
    if len(footage) > 1 and (change := moves(footage)) > STILL:
        told = f"clip.toml says static, but the view changes by {change:.3f} standard deviations"
        return wrong(CHECK, told, "say static = false, and write motion")
    return fine(CHECK, "static, and the view does not change")
