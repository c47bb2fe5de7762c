"""The reference: two independent halves, little remaining noise, a usable exposure."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.noise_statistics import (
    correlate,
    local_mean,
    match_brightness,
    ratio_of_sums,
)
from rlbench.checks.result import CheckResult, failed, passed, warning
from rlbench.ops.color import encode_srgb

MIN_NOISE, MAX_NOISE = 0.6, 1.8  # of the halves, times the noise that the samples predict; our
# clips have 0.94 to 1.2
SIGMAS = 5.0  # standard errors by which a value must deviate
MAX_CORRELATION = 0.1  # between the noise of neighbours; more comes from a filter
LOW_PSNR, TOO_LOW_PSNR = 28.0, 22.0  # noise ceiling, dB
MANY_CLIPPED, TOO_MANY_CLIPPED = 0.5, 0.95  # share of pixels above display white
DARK, TOO_DARK = 5e-3, 5e-4  # mean of the displayed image, linear
MAX_PSNR = 100.0  # dB


def has_one_reference(arrays: ClipArrays) -> bool:
    """Are both halves the same image, so that nothing is known of the reference's noise?"""
    return bool((arrays.half_a == arrays.half_b).all())


def check_halves(arrays: ClipArrays) -> CheckResult:
    """Are the halves independent, with as much noise as their samples per pixel predict?

    Shared samples cannot be detected where clip.toml says that samples are stratified.
    """
    check = "reference halves"
    if has_one_reference(arrays):
        remedy = "render two halves with different seeds; equal ones hide the reference's noise"
        return failed(check, "both halves are the same image", remedy)
    noise = (arrays.half_a - arrays.half_b) / local_mean(arrays.reference)
    for one, other in ((noise[..., 1:], noise[..., :-1]), (noise[..., 1:, :], noise[..., :-1, :])):
        value, error = correlate(one.clamp(-1, 1), other.clamp(-1, 1))
        if value > max(MAX_CORRELATION, SIGMAS * error):
            found = (
                f"expected noise that is independent between pixels, found a correlation of "
                f"{value:.2f} +- {error:.2f} with the next pixel"
            )
            remedy = "use no denoiser and no filter wider than a pixel for references"
            return failed(check, found, remedy)
    return _check_noise_level(arrays, check)


def _check_noise_level(arrays: ClipArrays, check: str) -> CheckResult:
    """Are the halves as noisy as the samples and reference_spp predict?"""
    if 0 in arrays.header.reference_spp[: len(arrays)]:
        found = "reference_spp is not known, so no noise level is predicted"
        return warning(check, found, "set reference_spp in clip.toml if it is known")
    value, error = half_noise_ratio(arrays)
    if math.isnan(value):
        found = "the pool has one sample per pixel, or no noise, so no noise level is predicted"
        return warning(check, found, "store more samples per pixel")
    found = f"noise is {value:.2f} +- {error:.2f} times that predicted from the samples"
    if arrays.header.stratified:
        found += ", which are stratified"
    elif value < MIN_NOISE and value + SIGMAS * error < 1:
        remedy = "render halves with different seeds; correct reference_spp if they have more"
        return failed(check, f"{found} (expected 1): the halves share samples", remedy)
    if value > MAX_NOISE and value - SIGMAS * error > 1:
        remedy = "correct reference_spp, or look for light paths that only the reference has"
        return warning(check, f"{found} (expected 1)", remedy)
    return passed(check, found)


def half_noise_ratio(arrays: ClipArrays) -> tuple[float, float]:
    """Variance of the halves over that predicted from the samples and spp; its standard error.

    Independent halves give 1, correlated ones 1 minus their correlation.
    """
    spp = torch.tensor(arrays.header.reference_spp[: len(arrays)]) / 2
    pool = match_brightness(next(iter(arrays.pools.values())), arrays.reference)
    if pool.shape[1] < 2 or float(pool.var(1).sum()) == 0:
        return math.nan, 0.0
    weight = local_mean((arrays.reference + pool.mean(1)) / 2).square().reciprocal()
    predicted = pool.var(1) / spp.view(-1, 1, 1, 1)
    return ratio_of_sums((arrays.half_a - arrays.half_b).square() / 2 * weight, predicted * weight)


def check_noise_ceiling(arrays: ClipArrays) -> CheckResult:
    """Which PSNR does the reference's own noise allow?"""
    check, value = "noise ceiling", noise_ceiling_db(arrays)
    if has_one_reference(arrays):
        found = "not known, because both halves are the same image"
        return warning(check, found, "render two halves with different seeds")
    spp = sorted(set(arrays.header.reference_spp))
    span = f"{spp[0]}" if len(spp) == 1 else f"{spp[0]} to {spp[-1]}"
    source = f"the reference has {span} spp" if spp[0] else "reference_spp is not known"
    found = f"a perfect image would have a PSNR of {value:.1f} dB; {source}"
    if value < TOO_LOW_PSNR:
        found += f"; expected at least {TOO_LOW_PSNR:g} dB"
        return failed(check, found, "render the reference with more samples")
    if value < LOW_PSNR:
        return warning(check, found, "render more samples, or compare methods by mse_debiased")
    return passed(check, found)


def noise_ceiling_db(arrays: ClipArrays) -> float:
    """PSNR (peak 1, clipped sRGB) of the truth against the mean of both halves; at most 100.

    The mean of independent halves has half the variance of one, a quarter of their difference's.
    """
    exposure = arrays.header.exposure
    a, b = (to_display(half * exposure) for half in (arrays.half_a, arrays.half_b))
    mse = float((a - b).double().square().mean()) / 4
    return min(MAX_PSNR, -10 * math.log10(max(mse, 1e-30)))


def check_exposure(arrays: ClipArrays) -> CheckResult:
    """Is radiance linear and unclipped, and does the exposure give a usable image?"""
    check, half = "exposure", arrays.half_a
    maximum = float(half.max())
    if maximum > 0 and bool(((half * 255).round() == half * 255).all()):
        return failed(check, "the reference has 8-bit values", "write linear radiance as float")
    at_maximum = float((half >= maximum * (1 - 1e-5)).float().mean())
    if min(abs(maximum - 1), abs(maximum - 255)) < 1e-3 and at_maximum > 5e-3:
        found = f"clipped: {at_maximum:.1%} of the reference's values are exactly {maximum:g}"
        return failed(check, found, "write linear radiance before any display transform")
    exposed = arrays.reference.mean(1) * arrays.header.exposure
    clipped, mean = float((exposed > 1).float().mean()), float(exposed.clamp(0, 1).mean())
    found = f"mean {mean:.3f} of display white, {clipped:.1%} of pixels above it"
    remedy = f"set another exposure in clip.toml; it is {arrays.header.exposure:g}"
    if clipped > TOO_MANY_CLIPPED or mean < TOO_DARK:
        return failed(check, found, remedy)
    if clipped > MANY_CLIPPED or mean < DARK:
        return warning(check, found, remedy)
    return passed(check, found)


def to_display(radiance: Float[Tensor, "*n 3 h w"]) -> Float[Tensor, "*n 3 h w"]:
    """Clipped sRGB values of exposed radiance."""
    return encode_srgb(radiance.clamp(0, 1))
