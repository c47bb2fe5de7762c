"""Checks that no other convention of motion reprojects a frame onto the next one better.

A convention is tried on how much of the change between two frames its motion explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.apps.dumps.importers.sky import judge_sky
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.apps.dumps.lint.jitter import REMEDY, find_jitter_fault
from rlbench.checks.result import CheckResult, failed, passed, warning
from rlbench.ops.reprojection import reproject

UNITS = {  # by scale: the unit of a layout, and a factor
    "pixels": ("pixels", 1.0),
    "half pixels": ("pixels", 0.5),
    "twice pixels": ("pixels", 2.0),
    "NDC (-1..1)": ("ndc", 1.0),
    "UV (0..1)": ("shares", 1.0),
}
DIRECTIONS = {"to the previous frame": -1, "to the next frame": 1}  # offset of the other frame
FLOOR = 0.01  # standard deviations: smaller differences are rounding and interpolation
CHECK, SKY = "motion", "sky motion"
MAX_PAIRS = 3  # pairs of frames on which the most likely conventions are compared
MAX_CONVENTIONS = 8  # number of most likely conventions
MIN_CHANGE = 1e-3  # mean change of the G-buffer, in standard deviations, that counts as motion
MIN_EXPLAINED = 0.05  # of the change: what explains less does not fit at all
MARGIN = 0.04  # of the change: smaller differences between conventions do not count; measured: at
# most 0.034 on our clips
MARGIN_OPPOSITE = 0.12  # the same for the opposite direction, which differs only by acceleration
# and disocclusion
CUT = 0.3  # times the median: a frame explained less than this looks like a cut


@dataclass(frozen=True)
class MotionConvention:
    """One interpretation of the two motion channels; the default is that of clip format v1."""

    swapped: bool = False  # is y the first channel?
    signs: tuple[int, int] = (1, 1)  # of x and y
    scale: str = "pixels"
    direction: str = "to the previous frame"

    def to_pixels(self, motion: Float[Tensor, "n 2 h w"]) -> Float[Tensor, "n 2 h w"]:
        """The motion in pixels, x right and y down."""
        h, w = motion.shape[-2:]
        ordered = motion.flip(1) if self.swapped else motion
        factor = torch.tensor(self.signs) * torch.tensor(_scales(h, w)[self.scale])
        return ordered * factor.view(1, 2, 1, 1)

    def __str__(self) -> str:
        """Both channels in order, their scale and their direction.

        >>> print(MotionConvention(signs=(1, -1), scale="NDC (-1..1)"))
        (x, -y) in NDC (-1..1), to the previous frame
        """
        x, y = ("-" * (sign < 0) for sign in self.signs)
        axes = f"({y}y, {x}x)" if self.swapped else f"({x}x, {y}y)"
        return f"{axes} in {self.scale}, {self.direction}"

    @property
    def opposite(self) -> MotionConvention:
        """The negative in the other direction, which differs only by acceleration."""
        x, y = self.signs
        (direction,) = set(DIRECTIONS) - {self.direction}
        return replace(self, signs=(-x, -y), direction=direction)

    def write_to(self, table: dict[str, Any]) -> None:
        """Write the convention as the keys of a layout."""
        if self.swapped:
            table["channels"] = table["channels"][::-1]
        unit, scale = UNITS[self.scale]
        x, y = self.signs
        table["unit"], table["y"] = unit, "down" if x == y else "up"
        # the sign of x: along the direction that the words name, or against it
        direction = " previous" if self.direction == FORMAT_V1.direction else " next"
        table["points"] = ("to" if x > 0 else "from") + direction
        if scale != 1:
            table["scale"] = scale


def format_share(share: float) -> str:
    """A share of the change in per cent, from -100 on: what is worse fits no better."""
    return f"{max(-1.0, min(1.0, share)):.0%}"


FORMAT_V1 = MotionConvention()
OPPOSITE = MotionConvention(False, (-1, -1), "pixels", "to the next frame")


def all_conventions() -> list[MotionConvention]:
    """Every combination of axis order, signs, scale and direction."""
    parts = product((False, True), product((1, -1), (1, -1)), _scales(1, 1), DIRECTIONS)
    return [MotionConvention(*part) for part in parts]


def _scales(h: int, w: int) -> dict[str, tuple[float, float]]:
    """Pixels per stored unit along x and y."""
    return {
        "pixels": (1.0, 1.0),
        "half pixels": (0.5, 0.5),
        "twice pixels": (2.0, 2.0),
        "NDC (-1..1)": (w / 2, h / 2),
        "UV (0..1)": (float(w), float(h)),
    }


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


def check_motion(arrays: ClipArrays) -> CheckResult:
    """Passes if motion points to the previous position of a pixel, and no other convention fits."""
    if result := _check_without_fit(arrays):
        return result
    ranked = rank_conventions(arrays)
    stored = dict(ranked)[FORMAT_V1]
    (rival, share), *_ = ranked
    margin = MARGIN_OPPOSITE if rival == OPPOSITE else MARGIN
    if share - stored > margin:
        found = (
            f"explains {format_share(share)} of the change as {rival}, but "
            f"{format_share(stored)} as {FORMAT_V1}"
        )
        return failed(CHECK, found, f"convert it from {rival}")
    if fault := find_jitter_fault(arrays):
        return failed(CHECK, fault, REMEDY)
    if stored < MIN_EXPLAINED:
        explained = format_share(stored)
        found = f"explains {explained} of the change between frames; no other convention fits"
        return failed(CHECK, found, "check the frame and the camera for which motion was computed")
    second = next(f"{format_share(s)} as {c}" for c, s in ranked if c not in (FORMAT_V1, OPPOSITE))
    found = f"explains {format_share(stored)} of the change as {FORMAT_V1}; next best {second}"
    return _check_cuts(arrays, found)


def check_sky(arrays: ClipArrays) -> CheckResult:
    """Passes if the sky moves as the camera turns; `check_motion` checks surfaces alone."""
    if arrays.header.static or not {"motion", "depth"} <= set(arrays.gbuffer):
        return passed(SKY, "not judged in a static clip, or without motion and depth")
    motion = arrays.gbuffer["motion"].movedim(1, -1).double().numpy()
    depth = arrays.gbuffer["depth"].movedim(1, -1).numpy()
    sky = np.isinf(depth[..., 0])
    verdicts = [judge_sky(*frame) for frame in zip(motion, sky, depth, strict=True)]
    if wrong := [index for index, verdict in enumerate(verdicts) if verdict != "stored"]:
        found = f"0 in {sky[wrong[0]].mean():.0%} of frame {wrong[0]}, while surfaces move"
        remedy = "compute it from the rotation of the camera, or let it point outside the image"
        if "unwritten" in verdicts:
            return failed(SKY, f"{found} as if the camera turned", remedy)
        return warning(SKY, f"{found}; their depths do not tell if the camera turns", remedy)
    return passed(SKY, f"consistent with surfaces; {sky.mean():.0%} of the pixels are sky")


def rank_conventions(arrays: ClipArrays) -> list[tuple[MotionConvention, float]]:
    """Likely conventions with the mean share that they explain, best first; v1's wins ties.

    All are compared on one pair of frames, and the best of them on up to MAX_PAIRS.
    """
    later = _frames_with_previous(arrays)
    middle = [t for t in later if t + 1 in later] or later

    def rank(
        conventions: Sequence[MotionConvention], frames: Sequence[int]
    ) -> list[tuple[MotionConvention, float]]:
        shares = []
        for convention in conventions:
            offset = max(DIRECTIONS[convention.direction], 0)
            usable = [t for t in frames if t + offset in later]
            if usable:
                shares.append(
                    (convention, float(explained_change(arrays, convention, usable).mean()))
                )
        return sorted(shares, key=lambda pair: (-pair[1], pair[0] != FORMAT_V1))

    first = [
        convention for convention, _ in rank(all_conventions(), middle[len(middle) // 2 :][:1])
    ]
    likely = list(dict.fromkeys([FORMAT_V1, *first[:MAX_CONVENTIONS]]))
    return rank(likely, middle[:: -(-len(middle) // MAX_PAIRS)])


def mean_change(arrays: ClipArrays) -> float:
    """Mean change of the G-buffer between frames of one shot, in standard deviations, at most 1."""
    later = torch.tensor(_frames_with_previous(arrays), dtype=torch.long)
    gbuffer = arrays.gbuffer
    images = [image for name, image in gbuffer.items() if name in ("albedo", "normal")]
    images += [1 / gbuffer["depth"]] if "depth" in gbuffer else []
    changes = [(v[later] - v[later - 1]).abs() / v.std().clamp_min(1e-6) for v in images]
    return max((float(change.clamp_max(1).mean()) for change in changes), default=0.0)


def _check_without_fit(arrays: ClipArrays) -> CheckResult | None:
    """The result if no convention needs to be fitted, or None."""
    if arrays.header.static:
        return _check_static(arrays)
    if "motion" not in arrays.gbuffer:
        remedy = "write one, or set static = true in clip.toml"
        return warning(CHECK, "the clip has no motion buffer", remedy)
    if fault := _find_motion_across_cut(arrays):
        remedy = "let motion point outside the image there, because the history is another shot"
        return failed(CHECK, fault, remedy)
    if not _frames_with_previous(arrays):
        return warning(CHECK, "no frame has a previous frame in its shot", "lint more frames")
    if mean_change(arrays) < MIN_CHANGE:
        remedy = "set static = true in clip.toml"
        return warning(CHECK, "nothing moves, so no convention can be determined", remedy)
    return None


def _check_static(arrays: ClipArrays) -> CheckResult:
    if len(arrays) > 1 and (change := mean_change(arrays)) > MIN_CHANGE:
        deviations = f"{change:.3f} standard deviations"
        found = f"clip.toml has static = true, but the G-buffer changes by {deviations}"
        return failed(CHECK, found, "set static = false in clip.toml, and write motion")
    return passed(CHECK, "static, and the G-buffer does not change")


def _check_cuts(arrays: ClipArrays, found: str) -> CheckResult:
    """A warning if one frame fits so badly that it looks like an undeclared cut."""
    later = _frames_with_previous(arrays)
    shares = explained_change(arrays, FORMAT_V1, later)
    if float(shares.min()) < CUT * float(shares.median()):
        found += f"; but {format_share(float(shares.min()))} in frame {later[int(shares.argmin())]}"
        remedy = "if a new shot begins there, add it to cuts, and let motion point outside"
        return warning(CHECK, found, remedy)
    return passed(CHECK, found)


def _frames_with_previous(arrays: ClipArrays) -> list[int]:
    """Frames whose previous frame belongs to the same shot."""
    return [t for t in range(1, len(arrays)) if t not in arrays.header.cuts]


def _find_motion_across_cut(arrays: ClipArrays) -> str:
    """The first cut at which motion points into the previous shot, or an empty string."""
    for index in (cut for cut in arrays.header.cuts if cut < len(arrays)):
        motion = arrays.gbuffer["motion"][index, None]
        inside = float(reproject(torch.zeros_like(motion), motion)[1].float().mean())
        if inside > 0:
            found = f"motion of {inside:.1%} of its pixels points inside the image"
            return f"frame {index} is a cut, but {found}"
    return ""
