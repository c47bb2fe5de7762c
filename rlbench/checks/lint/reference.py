"""Is the reference as good as it says: two independent halves, with little noise left?"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.finding import Finding, fine, odd, wrong
from rlbench.checks.lint import noise_statistics
from rlbench.checks.lint.clip_arrays import ClipArrays

LESS, MORE = (
    0.6,
    1.8,
)  # times the noise that the samples predict, that halves may have; ours 0.94-1.2
SIGMAS = 5.0  # standard errors that it must be away
FILTERED = 0.1  # correlation of the noise of neighbours, from which on it is filtered
LOW, TOO_LOW = 28.0, 22.0  # dB
CLIPPED, ALL = 0.5, 0.95  # share of pixels above display white
BLACK, DIM = 5e-4, 5e-3  # mean of what is shown, linear
CAP_DB = 100.0


def halves(footage: ClipArrays) -> Finding:
    """Are the halves independent, with as much noise as their samples per pixel give?

    That they share samples cannot be told where these are stratified, as clip.toml then says.
    """
    check = "halves"
    if bool((footage.half_a == footage.half_b).all()):
        remedy = "trace two halves with seeds of their own; equal ones hide the reference's noise"
        return wrong(check, "both halves are the same image", remedy)
    apart = (footage.half_a - footage.half_b) / noise_statistics.level(footage.reference)
    for one, other in ((apart[..., 1:], apart[..., :-1]), (apart[..., 1:, :], apart[..., :-1, :])):
        alike, error = noise_statistics.correlation(one.clamp(-1, 1), other.clamp(-1, 1))
        if alike > max(FILTERED, SIGMAS * error):
            told = f"their noise correlates by {alike:.2f} with that of the next pixel"
            return wrong(check, told, "no denoiser and no filter wider than a pixel on references")
    return _predicted(footage, check)


def _predicted(footage: ClipArrays, check: str) -> Finding:
    """Are they as noisy as the samples and their numbers say?"""
    if 0 in footage.header.reference_spp[: len(footage)]:
        return odd(check, "reference_spp is not known, so nothing is predicted", "say it, if known")
    value, error = half_noise(footage)
    told = f"noise {value:.2f} +- {error:.2f} times what the samples predict"
    if math.isnan(value):
        return odd(check, "one sample a pixel, or none with noise, predicts nothing", "store more")
    if footage.header.stratified:
        told = f"noise {value:.2f} +- {error:.2f} times that of independent samples, as stratified"
    elif value < LESS and value + SIGMAS * error < 1:
        remedy = "trace halves with seeds of their own; correct reference_spp if they have more"
        return wrong(check, f"{told}: they share samples", remedy)
    if value > MORE and value - SIGMAS * error > 1:
        return odd(check, told, "correct reference_spp, or look for what only references see")
    return fine(check, told)


def half_noise(footage: ClipArrays) -> tuple[float, float]:
    """Variance of the halves over what the samples' variance and spp predict; its error.

    Independent halves have 1, correlated ones 1 minus their correlation.
    """
    count = torch.tensor(footage.header.reference_spp[: len(footage)]) / 2
    pool = noise_statistics.alike(next(iter(footage.pools.values())), footage.reference)
    if pool.shape[1] < 2 or float(pool.var(1).sum()) == 0:
        return math.nan, 0.0
    weight = noise_statistics.level((footage.reference + pool.mean(1)) / 2).square().reciprocal()
    expected = pool.var(1) / count.view(-1, 1, 1, 1)
    return noise_statistics.ratio(
        (footage.half_a - footage.half_b).square() / 2 * weight, expected * weight
    )


def ceiling(footage: ClipArrays) -> Finding:
    """How large a PSNR does the reference's own noise allow?"""
    check, value = "noise ceiling", ceiling_db(footage)
    spp = sorted(set(footage.header.reference_spp))
    source = f"reference of {spp[0]} to {spp[-1]} spp" if spp[0] else "reference_spp is not known"
    told = f"a perfect image would have {value:.1f} dB PSNR; {source}"
    if value < TOO_LOW:
        return wrong(check, told, "trace the reference with more samples")
    if value < LOW:
        return odd(check, told, "more samples, or compare by mse_debiased")
    return fine(check, told)


def ceiling_db(footage: ClipArrays) -> float:
    """PSNR (peak 1, clipped sRGB) of the truth against the mean of both halves; at most 100.

    The mean of independent halves has half the variance of one, a quarter of their difference's.
    """
    a, b = (shown(half * footage.header.exposure) for half in (footage.half_a, footage.half_b))
    mse = float((a - b).double().square().mean()) / 4
    return min(CAP_DB, -10 * math.log10(max(mse, 1e-30)))


def exposure(footage: ClipArrays) -> Finding:
    """Is radiance linear and unclipped, and does the exposure make a picture of it?"""
    check = "exposure"
    light = footage.reference
    top = float(footage.half_a.max())
    if top > 0 and bool(((footage.half_a * 255).round() == footage.half_a * 255).all()):
        return wrong(check, "the reference has 8-bit values", "write linear radiance as float")
    at_top = float((footage.half_a >= top * (1 - 1e-5)).float().mean())
    if min(abs(top - 1), abs(top - 255)) < 1e-3 and at_top > 5e-3:
        told = f"{at_top:.1%} of the reference's values are exactly {top:g}"
        return wrong(check, told, "write linear radiance before any display transform")
    luminance = light.mean(1) * footage.header.exposure
    clipped, mean = float((luminance > 1).float().mean()), float(luminance.clamp(0, 1).mean())
    told = f"mean {mean:.3f} of display white, {clipped:.1%} of pixels above it"
    remedy = f"exposure is {footage.header.exposure:g}: choose another"
    if clipped > ALL or mean < BLACK:
        return wrong(check, told, remedy)
    return odd(check, told, remedy) if clipped > CLIPPED or mean < DIM else fine(check, told)


def shown(radiance: Float[Tensor, "*n 3 h w"]) -> Float[Tensor, "*n 3 h w"]:
    """Clipped sRGB (IEC 61966-2-1)."""
    linear = radiance.clamp(0, 1)
    return torch.where(
        linear > 0.0031308, 1.055 * linear.clamp_min(1e-4) ** (1 / 2.4) - 0.055, 12.92 * linear
    )
