"""Edges: radiance changes in proportion to linear albedo, and all buffers are the same way up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, absent
from rlbench.checks.result import CheckResult, failed, passed, warning

GAP = 3  # pixels between two compared ones: radiance is filtered over a pixel, albedo is not
MIN_COLOUR_CHANGE = 0.2  # of the log ratio of two channels, from which on it is a texture edge
MAX_SLOPE = 0.05  # change of log albedo to the next pixel, below which a pixel is inside a patch
MIN_PAIRS = 200  # pairs of pixels from which a gamma can be estimated
MAX_GAMMA = 1.25  # slope that gloss cannot explain; linear clips of ours have 0.5 to 1.0, encoded
# ones 1.1 to 2.2
MIN_ALBEDO = 0.02  # albedo below which logarithms are unreliable
WINDOW = 9  # pixels: ranks of edges are compared with this neighbourhood
MARGIN = 0.05  # of correlation, by which another orientation must fit better; chance gives less
# than 0.02 on our clips
STORED = "as stored"


def check_albedo(arrays: ClipArrays) -> CheckResult:
    """Passes if albedo is linear, in [0, 1], and not black."""
    if "albedo" not in arrays.gbuffer:
        return absent("albedo")
    albedo = arrays.gbuffer["albedo"]
    low, high = float(albedo.min()), float(albedo.max())
    outside = float(((albedo < -1e-3) | (albedo > 1.001)).float().mean())
    if outside > 0:
        found = f"expected [0, 1], found {outside:.2%} of values outside: {low:.3g} to {high:.3g}"
        remedy = "divide by 255" if high > 2 else "store reflectance in [0, 1], not radiance"
        return failed("albedo", found, remedy)
    if high < 1e-3:
        return failed(
            "albedo", "black everywhere", "check the pass: only emitters have black albedo"
        )
    return _check_gamma(colour_slopes(arrays), f"{low:.2g} to {high:.2g}")


def _check_gamma(slopes: Tensor, span: str) -> CheckResult:
    if len(slopes) < MIN_PAIRS:
        found = f"{span}; {len(slopes)} pairs at texture edges are too few to estimate a gamma"
        return passed("albedo", found)
    slope = float(slopes.median())
    found = f"{span}; colours of radiance vary as those of albedo ^ {slope:.2f}"
    if slope > MAX_GAMMA:
        found += f" (expected at most {MAX_GAMMA:g}), so it is gamma-encoded"
        return failed("albedo", found, "store it linear: decode sRGB")
    return passed("albedo", found)


def colour_slopes(arrays: ClipArrays) -> Float[Tensor, " pairs"]:
    """Change of log radiance over change of log albedo, in ratios of two channels.

    Measured over pairs of pixels on one smooth surface, each inside a patch of texture. Radiance of
    a diffuse surface is albedo times light, so linear albedo has slope 1 where the colour of the
    light is equal on both sides, and albedo ^ (1 / 2.2) has 2.2. Shadows and shading cancel in the
    ratio; white gloss lowers it. Therefore albedo that was decoded twice cannot be detected.
    """
    if not {"albedo", "normal", "depth"} <= set(arrays.gbuffer):
        return arrays.half_a.new_zeros(0)
    albedo = arrays.gbuffer["albedo"]
    log_albedo, log_radiance = (x.clamp_min(1e-6).log() for x in (albedo, arrays.reference))
    slopes = []
    for axis in (-1, -2):
        usable = _usable_pairs(arrays, albedo, log_albedo, axis)
        change = _at(log_albedo, axis, GAP) - _at(log_albedo, axis, 0)
        response = _at(log_radiance, axis, GAP) - _at(log_radiance, axis, 0)
        for one, two in ((0, 1), (1, 2), (2, 0)):
            colour = change[:, one] - change[:, two]
            slope = (response[:, one] - response[:, two]) / colour
            slopes.append(slope[usable & (colour.abs() > MIN_COLOUR_CHANGE)])
    return torch.cat(slopes)


def _usable_pairs(arrays: ClipArrays, albedo: Tensor, log_albedo: Tensor, axis: int) -> Tensor:
    """[t h w] Pairs on one surface, not black, both inside a patch of texture."""
    usable = _is_same_surface(arrays, axis)
    for offset in (0, GAP):
        usable = usable & (_at(albedo, axis, offset) > MIN_ALBEDO).all(1)
    for inner, outer in ((0, -1), (GAP, GAP + 1)):
        change = (_at(log_albedo, axis, inner) - _at(log_albedo, axis, outer)).abs()
        usable = usable & (change < MAX_SLOPE).all(1)
    return usable


def _is_same_surface(arrays: ClipArrays, axis: int) -> Tensor:
    """[t h w] True where both pixels of a pair have the same normal and nearly the same depth."""
    normal, depth = arrays.gbuffer["normal"], arrays.gbuffer["depth"]
    bend: Tensor = (_at(normal, axis, 0) - _at(normal, axis, GAP)).norm(dim=1)
    first, second = _at(depth, axis, 0)[:, 0], _at(depth, axis, GAP)[:, 0]
    close: Tensor = first.isfinite() & ((first - second).abs() < 0.05 * first.abs())
    return close & (bend < 0.03)


def _at(image: Tensor, axis: int, offset: int) -> Tensor:
    """The image at `offset` pixels from each first pixel of a pair; offsets -1 to GAP + 1 fit."""
    return image.narrow(axis, 1 + offset, max(image.shape[axis] - GAP - 2, 0))


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
    """Passes if G-buffer and samples have the orientation of the reference.

    Rows run from the top, columns from the left.

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
        return failed("orientation", "; ".join(parts), remedy)
    if all(fit[STORED] < MARGIN for fit in correlations.values()):
        found = f"too few edges to decide: {stored}"
        return warning("orientation", found, "inspect the figure of rlbench lint --figure")
    return passed("orientation", f"edges correlate with those of the reference: {stored}")


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

    Equal values have equal ranks, so what has no edge has no detail.
    This removes gradients over the whole image, which two mirrored images can share.
    """
    flat = image.mean(1).flatten(1).contiguous()
    ordered = flat.sort(1).values
    first, end = (torch.searchsorted(ordered, flat, side=side) for side in ("left", "right"))
    ranks = ((first + end - 1).float() / (2 * flat.shape[1])).view_as(image[:, :1])
    margin = [WINDOW // 2] * 4
    return ranks - F.avg_pool2d(F.pad(ranks, margin, mode="replicate"), WINDOW, 1)


def _correlate(one: Tensor, other: Tensor) -> float:
    one, other = one - one.mean(), other - other.mean()
    return float((one * other).sum() / (one.norm() * other.norm()).clamp_min(1e-9))
