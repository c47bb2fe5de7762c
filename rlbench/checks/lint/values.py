"""Values that no clip may have: NaN, infinity, negative radiance."""

from __future__ import annotations

import torch
from torch import Tensor

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.result import CheckResult, failed, passed
from rlbench.clips.frame_files import nonfinite_mask

MAX_PLACES = 3  # pixels that a message lists


def check_finite(arrays: ClipArrays) -> CheckResult:
    """Is every value finite, except the depth of the background?"""
    images = {**arrays.gbuffer, **_radiance(arrays)}
    masks = {
        name: torch.from_numpy(nonfinite_mask(name, image.numpy()))
        for name, image in images.items()
    }
    remedy = "find their origin: a NaN in one sample spreads through every filter"
    return _report("finite values", masks, "NaN or infinite", remedy)


def check_non_negative(arrays: ClipArrays) -> CheckResult:
    """Is radiance nowhere negative?"""
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
