"""Albedo: is it linear reflectance? Radiance must change in proportion where albedo changes."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.result import CheckResult, failed, passed, warning

CHECK = "albedo"
GAP = 3  # pixels between two compared ones: radiance is filtered over a pixel, albedo is not
MIN_COLOUR_CHANGE = 0.2  # of the log ratio of two channels, from which on it is a texture edge
MAX_SLOPE = 0.05  # change of log albedo to the next pixel, below which a pixel is inside a patch
MIN_PAIRS = 200  # pairs of pixels from which a gamma can be estimated
MAX_GAMMA = 1.25  # slope that gloss cannot explain; linear clips of ours have 0.5 to 1.0, encoded
# ones 1.1 to 2.2
MIN_ALBEDO = 0.02  # albedo below which logarithms are unreliable


def check_albedo(arrays: ClipArrays) -> CheckResult:
    """Is albedo linear, in [0, 1], and not black?"""
    if "albedo" not in arrays.gbuffer:
        return warning(
            CHECK, "the clip has no albedo buffer", "write one if a method needs it as input"
        )
    albedo = arrays.gbuffer["albedo"]
    low, high = float(albedo.min()), float(albedo.max())
    outside = float(((albedo < -1e-3) | (albedo > 1.001)).float().mean())
    if outside > 0:
        found = f"expected [0, 1], found {outside:.2%} of values outside: {low:.3g} to {high:.3g}"
        remedy = "divide by 255" if high > 2 else "store reflectance in [0, 1], not radiance"
        return failed(CHECK, found, remedy)
    if high < 1e-3:
        return failed(CHECK, "black everywhere", "check the pass: only emitters have black albedo")
    return _check_gamma(colour_slopes(arrays), f"{low:.2g} to {high:.2g}")


def _check_gamma(slopes: Tensor, span: str) -> CheckResult:
    if len(slopes) < MIN_PAIRS:
        found = f"{span}; {len(slopes)} pairs at texture edges are too few to estimate a gamma"
        return passed(CHECK, found)
    slope = float(slopes.median())
    found = f"{span}; colours of radiance vary as those of albedo ^ {slope:.2f}"
    if slope > MAX_GAMMA:
        found += f" (expected at most {MAX_GAMMA:g}), so it is gamma-encoded"
        return failed(CHECK, found, "store it linear: decode sRGB")
    return passed(CHECK, found)


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
    """[t h w] Do both pixels of a pair have the same normal and nearly the same depth?"""
    normal, depth = arrays.gbuffer["normal"], arrays.gbuffer["depth"]
    bend: Tensor = (_at(normal, axis, 0) - _at(normal, axis, GAP)).norm(dim=1)
    first, second = _at(depth, axis, 0)[:, 0], _at(depth, axis, GAP)[:, 0]
    close: Tensor = first.isfinite() & ((first - second).abs() < 0.05 * first.abs())
    return close & (bend < 0.03)


def _at(image: Tensor, axis: int, offset: int) -> Tensor:
    """The image at `offset` pixels from each first pixel of a pair; offsets -1 to GAP + 1 fit."""
    return image.narrow(axis, 1 + offset, max(image.shape[axis] - GAP - 2, 0))
