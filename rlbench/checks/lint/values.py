"""Values that no clip may hold: not finite, or radiance below zero."""

from __future__ import annotations

import torch
from torch import Tensor

from rlbench.checks.finding import Finding, fine, wrong
from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.clips.frame_files import not_finite

SHOWN = 3  # places that are told


def finite(footage: ClipArrays) -> Finding:
    """Is every value finite, but for depth's background?"""
    bad = {
        name: torch.from_numpy(not_finite(name, image.numpy()))
        for name, image in _all(footage).items()
    }
    remedy = "find out what made them; a NaN in one sample spreads through every filter"
    return _told("finite", bad, "NaN or infinite", remedy)


def positive(footage: ClipArrays) -> Finding:
    """Is radiance nowhere negative?"""
    bad = {name: image < 0 for name, image in _radiance(footage).items()}
    remedy = "clip at 0, and look for a filter with negative lobes or a wrong colour matrix"
    return _told("not negative", bad, "negative", remedy)


def _told(check: str, bad: dict[str, Tensor], what: str, remedy: str) -> Finding:
    count = {name: int(mask.sum()) for name, mask in bad.items()}
    if not sum(count.values()):
        return fine(check, f"no value is {what}")
    places = [_place(name, mask) for name, mask in bad.items() if count[name]][:SHOWN]
    parts = ", ".join(f"{number} in {name}" for name, number in count.items() if number)
    return wrong(check, f"{what}: {parts}; first: {'; '.join(places)}", remedy)


def _place(name: str, mask: Tensor) -> str:
    at = [int(i) for i in mask.nonzero()[0]]
    slot = f" sample {at[1]}" if mask.ndim == 5 else ""
    return f"{name} frame {at[0]}{slot} at x {at[-1]}, y {at[-2]}"


def _radiance(footage: ClipArrays) -> dict[str, Tensor]:
    pools = {f"pool {kind}": pool for kind, pool in footage.pools.items()}
    return {**pools, "reference A": footage.half_a, "reference B": footage.half_b}


def _all(footage: ClipArrays) -> dict[str, torch.Tensor]:
    return {**footage.gbuffer, **_radiance(footage)}
