"""Motion: does the stored convention reproject one frame onto the next, and no other better?"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.motion_conventions import (
    DIRECTIONS,
    FORMAT_V1,
    OPPOSITE,
    MotionConvention,
    all_conventions,
)
from rlbench.checks.lint.reprojection_error import explained_change
from rlbench.checks.result import CheckResult, failed, passed, warning
from rlbench.ops.reprojection import reproject

CHECK = "motion"
MAX_PAIRS = 3  # pairs of frames on which the most likely conventions are compared
MAX_CONVENTIONS = 8  # number of most likely conventions
MIN_CHANGE = 1e-3  # mean change of the G-buffer, in standard deviations, that counts as motion
MIN_EXPLAINED = 0.05  # of the change: what explains less does not fit at all
MARGIN = 0.04  # of the change: smaller differences between conventions do not count; measured: at
# most 0.034 on our clips
MARGIN_OPPOSITE = 0.12  # the same for the opposite direction, which differs only by acceleration
# and disocclusion
CUT = 0.3  # times the median: a frame explained less than this looks like a cut


def check_motion(arrays: ClipArrays) -> CheckResult:
    """Does motion point to the previous position of a pixel, and does no other convention fit?"""
    if result := _check_without_fit(arrays):
        return result
    ranked = rank_conventions(arrays)
    stored = dict(ranked)[FORMAT_V1]
    (rival, share), *_ = ranked
    margin = MARGIN_OPPOSITE if rival == OPPOSITE else MARGIN
    if share - stored > margin:
        found = f"explains {share:.0%} of the change as {rival}, but {stored:.0%} as {FORMAT_V1}"
        return failed(CHECK, found, f"convert it from {rival}")
    if stored < MIN_EXPLAINED:
        found = f"explains {stored:.0%} of the change between frames; no other convention fits"
        return failed(CHECK, found, "check the frame and the camera for which motion was computed")
    second = next(f"{s:.0%} as {c}" for c, s in ranked if c not in (FORMAT_V1, OPPOSITE))
    found = f"explains {stored:.0%} of the change as {FORMAT_V1}; next best {second}"
    return _check_cuts(arrays, found)


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
        found += f"; but {shares.min():.0%} in frame {later[int(shares.argmin())]}"
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
