"""All checks of clips, and their figures.

No value is NaN, infinite or negative. What a clip declares not to have is a warning, no failure.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, read_clip_arrays
from rlbench.apps.dumps.lint.edges import (
    check_albedo,
    check_orientation,
    correlate_orientations,
    misoriented,
    reoriented,
)
from rlbench.apps.dumps.lint.figure import draw_figure
from rlbench.apps.dumps.lint.geometry import (
    DepthFit,
    check_depth,
    check_normals,
    fit_depth_kinds,
    normalize,
)
from rlbench.apps.dumps.lint.motion import check_motion, check_sky
from rlbench.apps.dumps.lint.radiance import (
    check_brightness,
    check_exposure,
    check_halves,
    check_noise_ceiling,
    check_noise_pattern,
    check_samples,
    check_seeds,
)
from rlbench.checks.result import CheckResult, Verdict, failed, passed, warning
from rlbench.clips.frame_files import nonfinite_mask
from rlbench.clips.header import BUFFER_CHANNELS, Header

MAX_PLACES = 3  # pixels that a message lists
EXCUSED = {  # the checks that fail because of a limitation
    "halves": ("reference halves", "sample independence"),
    "independence": ("sample independence", "noise pattern", "independent seeds"),
    "linear": ("exposure", "brightness", "albedo", "sample independence", "reference halves"),
    "flow": ("motion",),
    **{name: (name, "orientation") for name in BUFFER_CHANNELS},
    "depth": ("depth", "normal", "orientation"),  # the background of one is compared with the other
    "normal": ("normal", "depth", "orientation"),
}
BY_REFERENCE = (  # the checks that compare with the reference
    *("sample independence", "independent seeds", "brightness", "reference halves"),
    *("noise ceiling", "exposure"),
)
MAX_FRAMES = 3  # frames whose normals are compared with their depth


def check_finite(arrays: ClipArrays) -> CheckResult:
    """Passes if every value is finite, except the depth of the background."""
    images = {**arrays.gbuffer, **_radiance(arrays)}
    masks = {
        name: torch.from_numpy(nonfinite_mask(name, image.numpy()))
        for name, image in images.items()
    }
    remedy = "find their origin: a NaN in one sample spreads through every filter"
    return _report("finite values", masks, "NaN or infinite", remedy)


def check_non_negative(arrays: ClipArrays) -> CheckResult:
    """Passes if no radiance is negative."""
    masks = {name: image < 0 for name, image in _radiance(arrays).items()}
    remedy = "clip at 0, and look for a filter with negative lobes or a wrong colour matrix"
    return _report("non-negative radiance", masks, "negative", remedy)


def _report(check: str, masks: dict[str, Tensor], fault: str, remedy: str) -> CheckResult:
    counts = {name: int(mask.sum()) for name, mask in masks.items()}
    if not sum(counts.values()):
        return passed(check, f"no value is {fault}")
    places = [_first_place(name, mask) for name, mask in masks.items() if counts[name]]
    parts = ", ".join(f"{count} in {name}" for name, count in counts.items() if count)
    first = "; ".join(places[:MAX_PLACES])
    return failed(check, f"{fault} values: {parts}; first: {first}", remedy)


def _first_place(name: str, mask: Tensor) -> str:
    index = [int(i) for i in mask.nonzero()[0]]
    sample = f" sample {index[1]}" if mask.ndim == 5 else ""
    return f"{name} frame {index[0]}{sample} at x {index[-1]}, y {index[-2]}"


def _radiance(arrays: ClipArrays) -> dict[str, Tensor]:
    pools = {f"pool {kind}": pool for kind, pool in arrays.pools.items()}
    return {**pools, "reference A": arrays.half_a, "reference B": arrays.half_b}


def excuse_declared(result: CheckResult, header: Header) -> CheckResult:
    """A warning in place of a failure that a declared limitation explains; else the result."""
    declared = [name for name in header.limitations if result.check in EXCUSED.get(name, ())]
    if result.verdict is not Verdict.FAILED or not declared:
        return result
    names = ", ".join(f"'{name}'" for name in declared)
    found = f"{result.found} (limitation {names} of clip.toml)"
    return replace(result, verdict=Verdict.WARNING, found=found)


def lint_clip(arrays: ClipArrays) -> list[CheckResult]:
    """The result of every check of a clip.

    Only the first check reports values that are not finite; all others see 0 in their place. Only
    the orientation check reports flipped pools; checks of the samples see them corrected.

    A buffer that the clip declares to be a stand-in counts as absent. A check that fails for a
    limitation that the clip declares is a warning.
    """
    arrays = arrays.without_stand_ins
    sanitized = arrays.sanitized
    fits, correlations = fit_depth(sanitized), correlate_orientations(sanitized)
    is_upright = not {"albedo", "normal", "depth"} & set(misoriented(correlations))
    upright = reoriented(sanitized, correlations)
    results = [
        check_finite(arrays),
        check_non_negative(sanitized),
        check_motion(sanitized),
        check_sky(sanitized),
        check_depth(sanitized, fits),
        check_normals(sanitized, fits, is_upright),
        check_albedo(sanitized),
        check_orientation(correlations),
        check_samples(upright),
        check_noise_pattern(upright),
        check_seeds(upright),
        check_brightness(upright),
        check_halves(upright),
        check_noise_ceiling(upright),
        check_exposure(upright),
    ]
    if "no reference" in arrays.header.limitations:
        results = [_without_reference(result) for result in results]
    return [excuse_declared(result, arrays.header) for result in results]


def _without_reference(result: CheckResult) -> CheckResult:
    """A warning in place of the result of a check that compares with the reference."""
    if result.check not in BY_REFERENCE:
        return result
    found = "frames have no reference, so nothing is compared with it (limitation of clip.toml)"
    return warning(result.check, found, "render one if methods are to be scored on this clip")


def fit_depth(arrays: ClipArrays) -> dict[str, DepthFit]:
    """The kinds of depth that fit the normals, over a few frames; may be empty."""
    if not {"depth", "normal"} <= set(arrays.gbuffer):
        return {}
    frames = torch.linspace(0, len(arrays) - 1, min(MAX_FRAMES, len(arrays))).long()
    depth = arrays.gbuffer["depth"][frames].abs()
    normal = normalize(arrays.gbuffer["normal"][frames])
    return fit_depth_kinds(depth.where(depth > 0, torch.inf), normal)


def lint_clips(
    folders: Sequence[Path], figure: Path | None = None, frames: int = 8
) -> Iterator[tuple[str, list[CheckResult]]]:
    """The title of each clip folder, and the results of its checks.

    Reads the first `frames` frames of each clip (0: all). `figure` is a PNG to write; with several
    clips, each has its own, with the folder's name appended. Raises ClipError where a folder is not
    a finished clip.
    """
    for folder in folders:
        arrays = read_clip_arrays(folder, frames)
        results = lint_clip(arrays)
        yield _title(arrays), results
        if figure:
            numbered = figure.with_name(f"{figure.stem}-{folder.name}.png")
            path = draw_figure(arrays, results, numbered if len(folders) > 1 else figure)
            sys.stderr.write(f"figure: {path}\n")


def _title(arrays: ClipArrays) -> str:
    header, read = arrays.header, len(arrays)
    frames = f"{read} of {header.frames}" if read < header.frames else f"{header.frames}"
    return f"{header.name}: {header.width} x {header.height} pixels, {frames} frames"
