"""Is albedo a linear share of light? Where it changes on one surface, radiance changes in step."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.lint.finding import Finding, fine, odd, wrong
from rlbench.lint.footage import Footage

CHECK = "albedo"
EDGE = 0.3  # natural logarithm: a change of albedo that is surely texture
LEAST = 200  # such pairs of pixels are needed to tell a gamma
GAMMA = 1.6  # slope of log radiance over log albedo from which on albedo is encoded (sRGB: 2.2)
DARK = 0.02  # albedo below which logarithms say little


def albedo(footage: Footage) -> Finding:
    """Is albedo linear, in [0, 1], and not black?"""
    if "albedo" not in footage.view:
        return odd(CHECK, "the clip has no albedo buffer", "write one if a method is to use it")
    stored = footage.view["albedo"]
    low, high = float(stored.min()), float(stored.max())
    outside = float(((stored < -1e-3) | (stored > 1.001)).float().mean())
    if outside > 0:
        told = f"{outside:.1%} of values are outside [0, 1]: {low:.3g} to {high:.3g}"
        divide = "divide by 255" if high > 2 else "bound it; it is a share of light, not radiance"
        return wrong(CHECK, told, divide)
    if high < 1e-3:
        return wrong(CHECK, "black everywhere", "check the pass; emitters alone are black")
    slopes = texture_slopes(footage)
    if len(slopes) < LEAST:
        told = f"{low:.2g} to {high:.2g}; too little texture in one light to tell a gamma"
        return fine(CHECK, told)
    slope = float(slopes.median())
    told = f"{low:.2g} to {high:.2g}; over edges of texture radiance changes as albedo ^ {slope:.2f}"
    if slope > GAMMA:
        return wrong(CHECK, f"{told}, so it is gamma-encoded", "store it linear: decode sRGB")
    if slope < 1 / GAMMA**2:
        return odd(CHECK, told, "check that albedo is not decoded twice, and is of what is seen")
    return fine(CHECK, told)


def texture_slopes(footage: Footage) -> Float[Tensor, " pairs"]:
    """Change of log radiance over that of log albedo, for neighbours that differ in albedo alone.

    1 for a diffuse surface, 1 / 2.2 of the truth's where ... see below; emission, gloss and shadow
    edges scatter it, so its median is what counts.
    """
    radiance, stored = footage.reference, footage.view["albedo"]
    slopes = []
    for axis in (-1, -2):
        one, two = _neighbours(stored, axis)
        light, other = _neighbours(radiance, axis)
        usable = (one > DARK) & (two > DARK) & (light > 0) & (other > 0)
        change = (two / one.clamp_min(1e-6)).clamp_min(1e-6).log()
        usable = usable & (change.abs() > EDGE) & _one_surface(footage, axis)
        response = (other / light.clamp_min(1e-9)).clamp_min(1e-9).log()
        slopes.append((response / change)[usable])
    return torch.cat(slopes)


def _one_surface(footage: Footage, axis: int) -> Tensor:
    """[t 1 h w] Do neighbours have the same normal and nearly the same depth?"""
    same = torch.ones_like(_neighbours(footage.a[:, :1], axis)[0], dtype=torch.bool)
    if "normal" in footage.view:
        one, two = _neighbours(footage.view["normal"], axis)
        same = same & ((one - two).norm(dim=1, keepdim=True) < 0.03)
    if "depth" in footage.view:
        one, two = _neighbours(footage.view["depth"], axis)
        same = same & one.isfinite() & ((one - two).abs() < 0.05 * one.abs())
    return same


def _neighbours(image: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    length = image.shape[axis]
    return image.narrow(axis, 0, length - 1), image.narrow(axis, 1, length - 1)
