"""Is albedo a linear share of light? Where its colour changes, that of radiance changes in step."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.finding import Finding, fine, odd, wrong
from rlbench.checks.lint.clip_arrays import ClipArrays

CHECK = "albedo"
GAP = 3  # pixels between two that are compared: radiance is filtered over a pixel, albedo is not
EDGE = 0.2  # change of the logarithm of a colour's ratio that is surely texture
LEVEL = 0.05  # change of log albedo to the next pixel, below which a pixel is inside its texture
LEAST = 200  # such pairs of pixels are needed to tell a gamma
GAMMA = 1.25  # slope that gloss cannot explain; ours have 0.5 to 1.0, and 1.1 to 2.2 if encoded
DARK = 0.02  # albedo below which logarithms say little


def albedo(footage: ClipArrays) -> Finding:
    """Is albedo linear, in [0, 1], and not black?"""
    if "albedo" not in footage.gbuffer:
        return odd(CHECK, "the clip has no albedo buffer", "write one if a method is to use it")
    stored = footage.gbuffer["albedo"]
    low, high = float(stored.min()), float(stored.max())
    outside = float(((stored < -1e-3) | (stored > 1.001)).float().mean())
    if outside > 0:
        told = f"{outside:.2%} of values are outside [0, 1]: {low:.3g} to {high:.3g}"
        remedy = "divide by 255" if high > 2 else "bound it: it is a share of light, not radiance"
        return wrong(CHECK, told, remedy)
    if high < 1e-3:
        return wrong(CHECK, "black everywhere", "check the pass; of surfaces only lamps are black")
    slopes = colour_slopes(footage)
    if len(slopes) < LEAST:
        return fine(CHECK, f"{low:.2g} to {high:.2g}; too few edges of texture to tell a gamma")
    slope = float(slopes.median())
    told = f"{low:.2g} to {high:.2g}; colours of radiance go as those of albedo ^ {slope:.2f}"
    if slope > GAMMA:
        return wrong(CHECK, f"{told}, so it is gamma-encoded", "store it linear: decode sRGB")
    return fine(CHECK, told)


def colour_slopes(footage: ClipArrays) -> Float[Tensor, " pairs"]:
    """Change of log radiance over that of log albedo, in ratios of two channels.

    Over pairs of pixels on one smooth surface, each inside its patch of texture. Radiance of a
    diffuse surface is albedo times light, so linear albedo has slope 1 where the light's colour is
    the same on both sides, and albedo ^ (1 / 2.2) has 2.2. Shadows and shading fall out of the
    ratio; white gloss makes it smaller. So albedo that was decoded twice cannot be told.
    """
    if not {"albedo", "normal", "depth"} <= set(footage.gbuffer):
        return footage.half_a.new_zeros(0)
    stored = footage.gbuffer["albedo"]
    log, light = (image.clamp_min(1e-6).log() for image in (stored, footage.reference))
    found = []
    for axis in (-1, -2):
        usable = _one_surface(footage, axis)
        usable = (
            usable & (_at(stored, axis, 0) > DARK).all(1) & (_at(stored, axis, GAP) > DARK).all(1)
        )
        for inner, outer in ((0, -1), (GAP, GAP + 1)):
            usable = usable & _level(log, axis, inner, outer)
        change = _at(log, axis, GAP) - _at(log, axis, 0)
        response = _at(light, axis, GAP) - _at(light, axis, 0)
        for one, two in ((0, 1), (1, 2), (2, 0)):
            colour = change[:, one] - change[:, two]
            slope = (response[:, one] - response[:, two]) / colour
            found.append(slope[usable & (colour.abs() > EDGE)])
    return torch.cat(found)


def _one_surface(footage: ClipArrays, axis: int) -> Tensor:
    """[t h w] Have both pixels of a pair the same normal and nearly the same depth?"""
    normal, depth = footage.gbuffer["normal"], footage.gbuffer["depth"]
    turned: Tensor = (_at(normal, axis, 0) - _at(normal, axis, GAP)).norm(dim=1)
    near, far = _at(depth, axis, 0)[:, 0], _at(depth, axis, GAP)[:, 0]
    close: Tensor = near.isfinite() & ((near - far).abs() < 0.05 * near.abs())
    return close & (turned < 0.03)


def _level(log: Tensor, axis: int, inner: int, outer: int) -> Tensor:
    return ((_at(log, axis, inner) - _at(log, axis, outer)).abs() < LEVEL).all(1)


def _at(image: Tensor, axis: int, offset: int) -> Tensor:
    """The image at `offset` pixels from each first pixel of a pair; offsets -1 to GAP + 1 fit."""
    return image.narrow(axis, 1 + offset, max(image.shape[axis] - GAP - 2, 0))
