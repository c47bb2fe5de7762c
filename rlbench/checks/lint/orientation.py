"""Orientation: are all buffers the same way up? Their edges must lie on each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.result import CheckResult, failed, passed, warning

CHECK = "orientation"
WINDOW = 9  # pixels: ranks of edges are compared with this neighbourhood
MARGIN = 0.05  # of correlation, by which another orientation must fit better; chance gives less
# than 0.02 on our clips
STORED = "as stored"
ORIENTATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    STORED: lambda image: image,
    "upside down": lambda image: image.flip(-2),
    "mirrored left to right": lambda image: image.flip(-1),
    "rotated by 180 degrees": lambda image: image.flip(-1, -2),
}
Correlations = dict[str, dict[str, float]]  # by buffer, then by orientation


def correlate_orientations(arrays: ClipArrays) -> Correlations:
    """For each buffer, the correlation of its edges in each orientation.

    Edges of albedo, normal, depth and samples are compared with those of the reference, edges of
    motion with those of depth and normal.
    """
    edges = {name: _edges(_linear(name, image)) for name, image in arrays.gbuffer.items()}
    log_reference = _log(arrays.reference)
    reference_edges, reference_detail = _edges(log_reference), _detail(log_reference)
    pairs = {name: (edge, reference_edges) for name, edge in edges.items() if name != "motion"}
    if {"motion", "normal", "depth"} <= set(edges):
        pairs["motion"] = (edges["motion"], edges["normal"] + edges["depth"])
    for kind, pool in arrays.pools.items():
        pairs[_pool_name(kind)] = (_detail(_log(pool.mean(1))), reference_detail)
    return {
        name: {way: _correlate(flip(edge), anchor) for way, flip in ORIENTATIONS.items()}
        for name, (edge, anchor) in pairs.items()
    }


def misoriented(correlations: Correlations) -> dict[str, str]:
    """The orientation of each buffer that is not oriented like the others, by its name."""
    best = {name: max(fit, key=lambda way: fit[way]) for name, fit in correlations.items()}
    return {
        name: way
        for name, way in best.items()
        if correlations[name][way] - correlations[name][STORED] > MARGIN
    }


def reoriented(arrays: ClipArrays, correlations: Correlations) -> ClipArrays:
    """The arrays with their pools oriented like the reference, for checks that compare the two."""
    ways = misoriented(correlations)
    pools = {
        kind: ORIENTATIONS[ways.get(_pool_name(kind), STORED)](pool)
        for kind, pool in arrays.pools.items()
    }
    return replace(arrays, pools=pools)


def check_orientation(correlations: Correlations) -> CheckResult:
    """Are G-buffer and samples oriented like the reference, rows from the top, columns from left?

    `correlations` is the result of `correlate_orientations`. A clip that is upside down as a whole
    passes.
    """
    stored = ", ".join(f"{name} {fit[STORED]:.2f}" for name, fit in correlations.items())
    if ways := misoriented(correlations):
        parts = (
            f"{name} is {way} (correlation of edges {correlations[name][way]:.2f}, "
            f"{correlations[name][STORED]:.2f} as stored)"
            for name, way in ways.items()
        )
        remedy = "write rows from the top and columns from the left; flip motion's axis with them"
        return failed(CHECK, "; ".join(parts), remedy)
    if all(fit[STORED] < MARGIN for fit in correlations.values()):
        found = f"too few edges to decide: {stored}"
        return warning(CHECK, found, "inspect the figure of rlbench lint --figure")
    return passed(CHECK, f"edges correlate with those of the reference: {stored}")


def _pool_name(kind: str) -> str:
    return f"pool {kind}"


def _linear(name: str, image: Tensor) -> Tensor:
    """Disparity in place of depth, which may be infinite."""
    return 1 / image.abs().clamp_min(1e-6) if name.startswith("depth") else image


def _log(radiance: Tensor) -> Tensor:
    return (radiance.clamp_min(0) + 1e-2 * radiance.mean().clamp_min(1e-6)).log()


def _edges(image: Float[Tensor, "t c h w"]) -> Float[Tensor, "t 1 h w"]:
    """Differences to the previous pixel, as detail of ranks."""
    change = torch.zeros_like(image[:, :1])
    change[..., 1:] += (image[..., 1:] - image[..., :-1]).abs().sum(1, keepdim=True)
    change[..., 1:, :] += (image[..., 1:, :] - image[..., :-1, :]).abs().sum(1, keepdim=True)
    return _detail(change)


def _detail(image: Float[Tensor, "t c h w"]) -> Float[Tensor, "t 1 h w"]:
    """Ranks in [0, 1] of the mean channel, minus the mean of their neighbourhood.

    This removes gradients over the whole image, which two mirrored images can share.
    """
    flat = image.mean(1).flatten(1)
    ranks = (flat.argsort(1).argsort(1).float() / flat.shape[1]).view_as(image[:, :1])
    margin = [WINDOW // 2] * 4
    return ranks - F.avg_pool2d(F.pad(ranks, margin, mode="replicate"), WINDOW, 1)


def _correlate(one: Tensor, other: Tensor) -> float:
    one, other = one - one.mean(), other - other.mean()
    return float((one * other).sum() / (one.norm() * other.norm()).clamp_min(1e-9))
