"""Checks that samples and reference are independent, linear, and as noisy as their spp predict.

Noise is measured by correlations and ratios, with standard errors estimated from blocks of pixels.
"""

from __future__ import annotations

import math
from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.checks.display import CAP_DB, to_display
from rlbench.checks.result import CheckResult, failed, passed, warning

BLOCK = 8  # pixels: noise may be correlated between neighbours within a block
WINDOW = 17  # pixels: side of the neighbourhood of a pixel
EPS = 1e-2  # of the mean radiance: keeps black pixels from dominating
SIGMAS = 5.0  # standard errors by which a value must deviate
MAX_FILTERED = 0.1  # correlation of a half's noise with the next pixel; more comes from a filter
MAX_CORRELATION = 0.05  # of independent samples; our clips scatter by a tenth of it
FAIL_CORRELATION = 0.15  # from which on a check fails instead of warning
MAX_COMMON_NOISE = 0.3  # excess of the error of the mean over that predicted from the samples
MAX_SHARED = 0.01  # correlation of samples with the difference of the halves; 64 shared spp give
# 0.09
MAX_BRIGHTNESS_ERROR = 0.03  # of the samples' mean, relative to the reference's mean
RESEED = (
    "render each sample with a different seed, in Cycles also with a different sample offset, "
    "unfiltered"
)
NO_FILTER = "use a box filter of one pixel, no denoiser and no upscaling"
PATTERN_REMEDIES = {
    "the pixel to the right": NO_FILTER,
    "the pixel below": NO_FILTER,
    "the next frame": "make the seed depend on the frame",
}


def bounded_noise(pool: Float[Tensor, "t s 3 h w"]) -> Float[Tensor, "t s 3 h w"]:
    """The samples as x / (x + mean of the pixel), minus the mean of that over the pixel's samples.

    Fireflies weigh no more than other samples, and independent samples stay independent given the
    pixel: any two of s then have the correlation -1 / (s - 1), whatever their distribution.
    """
    level = pool.mean(1, keepdim=True) + EPS * pool.mean()
    bounded = pool / (pool + level).clamp_min(1e-12)
    return bounded - bounded.mean(1, keepdim=True)


def correlate(
    one: Float[Tensor, "n 3 h w"], other: Float[Tensor, "n 3 h w"]
) -> tuple[float, float]:
    """Correlation of two noise images with mean zero, and its standard error."""
    norm = (one.square().sum() * other.square().sum()).sqrt().clamp_min(1e-20)
    blocks = _block_sums(one * other)
    return float(blocks.sum() / norm), float(blocks.square().sum().sqrt() / norm)


def ratio_of_sums(
    numerator: Float[Tensor, "n 3 h w"], denominator: Float[Tensor, "n 3 h w"]
) -> tuple[float, float]:
    """Ratio of two sums, and its standard error (delta method)."""
    top, bottom = _block_sums(numerator), _block_sums(denominator)
    total = bottom.sum().clamp_min(1e-20)
    ratio = top.sum() / total
    return float(ratio), float((top - ratio * bottom).square().sum().sqrt() / total)


def local_mean(image: Float[Tensor, "t 3 h w"]) -> Float[Tensor, "t 3 h w"]:
    """Mean of the neighbourhood of each pixel, >= 0, and above 0 unless the image is black.

    Noise is measured relative to it rather than to the pixel, whose own noise would bias the
    weight.
    """
    padded = F.pad(image.clamp_min(0), [WINDOW // 2] * 4, mode="reflect")
    return F.avg_pool2d(padded, WINDOW, 1) + EPS * image.mean().clamp_min(1e-12)


def match_brightness(
    pool: Float[Tensor, "t s 3 h w"], reference: Float[Tensor, "t 3 h w"]
) -> Float[Tensor, "t s 3 h w"]:
    """The samples scaled to the reference's mean, so that only one check depends on brightness."""
    return pool * (reference.sum() / pool.mean(1).sum().clamp_min(1e-12))


def _block_sums(image: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " blocks"]:
    """Sums over channels and blocks of BLOCK x BLOCK pixels; blocks at the edge are smaller."""
    h, w = image.shape[-2:]
    padded = F.pad(image.sum(1, keepdim=True), (0, -w % BLOCK, 0, -h % BLOCK))
    return torch.flatten(F.avg_pool2d(padded, BLOCK) * BLOCK**2).double()


MIN_NOISE, MAX_NOISE = 0.6, 1.8  # of the halves, times the noise that the samples predict; our
# clips have 0.94 to 1.2
LOW_PSNR, TOO_LOW_PSNR = 28.0, 22.0  # noise ceiling, dB
MANY_CLIPPED, TOO_MANY_CLIPPED = 0.5, 0.95  # share of pixels above display white
DARK, TOO_DARK = 5e-3, 5e-4  # mean of the displayed image, linear


def has_one_reference(arrays: ClipArrays) -> bool:
    """True if both halves are the same image, so that the reference's noise is unknown."""
    return bool((arrays.half_a == arrays.half_b).all())


def check_halves(arrays: ClipArrays) -> CheckResult:
    """Passes if the halves are independent, with the noise that their samples per pixel predict.

    Shared samples cannot be detected where clip.toml says that samples are stratified.
    """
    check = "reference halves"
    if has_one_reference(arrays):
        remedy = "render two halves with different seeds; equal ones hide the reference's noise"
        return failed(check, "both halves are the same image", remedy)
    noise = (arrays.half_a - arrays.half_b) / local_mean(arrays.reference)
    for one, other in ((noise[..., 1:], noise[..., :-1]), (noise[..., 1:, :], noise[..., :-1, :])):
        value, error = correlate(one.clamp(-1, 1), other.clamp(-1, 1))
        if value > max(MAX_FILTERED, SIGMAS * error):
            found = (
                f"expected noise that is independent between pixels, found a correlation of "
                f"{value:.2f} +- {error:.2f} with the next pixel"
            )
            remedy = "use no denoiser and no filter wider than a pixel for references"
            return failed(check, found, remedy)
    return _check_noise_level(arrays, check)


def _check_noise_level(arrays: ClipArrays, check: str) -> CheckResult:
    """Passes if the halves are as noisy as the samples and reference_spp predict."""
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
    """The highest PSNR that the reference's noise allows; a warning if it is low or unknown."""
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
    return min(CAP_DB, -10 * math.log10(max(mse, 1e-30)))


def check_exposure(arrays: ClipArrays) -> CheckResult:
    """Passes if radiance is linear and unclipped, and the exposure gives a usable image."""
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


def check_samples(arrays: ClipArrays) -> CheckResult:
    """Passes if the samples of a pixel are independent of each other."""
    check, parts = "sample independence", []
    for kind, pool in arrays.pools.items():
        if pool.shape[1] < 2:
            parts.append(f"pool {kind} has one sample")
            continue
        found = _check_pairs(check, kind, pool)
        if isinstance(found, CheckResult):
            return found
        parts.append(found)
        common, error = _common_noise(arrays, kind)
        if common > max(MAX_COMMON_NOISE, 3 * error):
            ratio = f"{1 + common:.1f} times as large as their variance predicts"
            fault = f"pool {kind}: the squared error of their mean is {ratio}, so all share noise"
            return failed(check, fault, RESEED)
    return passed(check, "; ".join(parts))


def _check_pairs(check: str, kind: str, pool: Tensor) -> CheckResult | str:
    """A result if two samples are equal or correlated, otherwise the highest correlation."""
    pairs = list(combinations(range(pool.shape[1]), 2))
    equal = [f"{i} and {j}" for i, j in pairs if _has_equal_frame(pool[:, i], pool[:, j])]
    if equal:
        return failed(check, f"pool {kind}: equal samples: {', '.join(equal[:4])}", RESEED)
    noise, expected = bounded_noise(pool), -1 / (pool.shape[1] - 1)
    correlations = {(i, j): correlate(noise[:, i], noise[:, j]) for i, j in pairs}
    i, j = max(correlations, key=lambda pair: correlations[pair][0])
    excess, error = correlations[i, j][0] - expected, correlations[i, j][1]
    if excess > max(MAX_CORRELATION, SIGMAS * error):
        fault = f"pool {kind}: samples {i} and {j} correlate by {excess:.2f} +- {error:.2f}"
        return _fail_or_warn(check, excess, fault, RESEED)
    return f"pool {kind}: pairs correlate by at most {excess:.3f} +- {error:.3f}"


def check_noise_pattern(arrays: ClipArrays) -> CheckResult:
    """Passes if the noise of a pixel is independent of the next pixel's and the next frame's."""
    check, parts = "noise pattern", []
    for kind, pool in arrays.pools.items():
        noise = bounded_noise(pool)
        neighbours = {
            "the pixel to the right": (noise[..., 1:], noise[..., :-1]),
            "the pixel below": (noise[..., 1:, :], noise[..., :-1, :]),
            "the next frame": (noise[1:], noise[:-1]),
        }
        for where, (one, other) in neighbours.items():
            if not one.numel():
                continue
            value, error = correlate(one.flatten(0, 1), other.flatten(0, 1))
            parts.append(f"{value:.3f} with {where}")
            if value > max(MAX_CORRELATION, SIGMAS * error):
                fault = f"pool {kind}: noise correlates by {value:.2f} +- {error:.2f} with {where}"
                return _fail_or_warn(check, value, fault, PATTERN_REMEDIES[where])
    return passed(check, f"noise correlates by {', '.join(parts)}")


def check_seeds(arrays: ClipArrays) -> CheckResult:
    """Passes if the samples are independent of the reference.

    The difference of the halves is pure noise with mean zero: a sample that is independent of both
    cannot correlate with it, whatever its distribution; a sample that is part of one half does.
    Samples that are part of both are found by `rlbench.apps.dumps.lint.radiance.check_halves`.
    """
    check, parts = "independent seeds", []
    if has_one_reference(arrays):
        found = "cannot be decided, because both halves are the same image"
        return warning(check, found, "render two halves with different seeds")
    difference = arrays.half_a - arrays.half_b
    # clamped, because fireflies would hide all other samples
    difference = (difference / local_mean(difference.abs())).clamp(-2, 2)
    for kind, pool in arrays.pools.items():
        name, value, error = _strongest_correlation(pool, difference)
        if abs(value) > max(MAX_SHARED, 4 * error):
            half = "A" if value > 0 else "B"
            correlated = f"correlates by {abs(value):.3f} +- {error:.3f}"
            fault = f"pool {kind}: {name} {correlated} with the noise of half {half}"
            remedy = "render pool and reference with different seeds, or methods see the reference"
            return failed(check, fault, remedy)
        parts.append(
            f"pool {kind}: at most {value:+.3f} +- {error:.3f} with the noise of the reference"
        )
    return passed(check, "; ".join(parts))


def _strongest_correlation(pool: Tensor, difference: Tensor) -> tuple[str, float, float]:
    """The sample, or mean of all, that correlates most significantly with `difference`."""
    noise = pool / (pool + local_mean(pool.mean(1))[:, None])
    noise = noise - local_mean(noise.mean(1))[:, None]
    images = {f"sample {slot}": noise[:, slot] for slot in range(pool.shape[1])}
    images["the mean of its samples"] = noise.mean(1)
    correlations = {name: correlate(image, difference) for name, image in images.items()}

    def significance(name: str) -> float:
        value, error = correlations[name]
        return abs(value) / max(error, 1e-9)

    strongest = max(correlations, key=significance)
    return strongest, *correlations[strongest]


def check_brightness(arrays: ClipArrays) -> CheckResult:
    """Passes if the mean of the samples equals that of the reference."""
    check, parts = "brightness", []
    for kind, pool in arrays.pools.items():
        value, error = ratio_of_sums(pool.mean(1), arrays.reference)
        parts.append(f"pool {kind}: {value:.3f} +- {error:.3f} times the reference's mean")
        if abs(value - 1) > max(MAX_BRIGHTNESS_ERROR, SIGMAS * error):
            remedy = "use the same exposure, clamping, encoding and light paths for both"
            return failed(check, f"{parts[-1]} (expected 1)", remedy)
    return passed(check, "; ".join(parts))


def _fail_or_warn(check: str, correlation: float, fault: str, remedy: str) -> CheckResult:
    return (failed if correlation > FAIL_CORRELATION else warning)(check, fault, remedy)


def _common_noise(arrays: ClipArrays, kind: str) -> tuple[float, float]:
    """Excess of the mean's squared error over the variance predicted from the samples; its error.

    (m - A)(m - B) is an unbiased estimate of the squared error of the mean m, because the halves
    are independent. m is first scaled to the reference's brightness, which another check compares.
    """
    pool = match_brightness(arrays.pools[kind], arrays.reference)
    weight = local_mean(arrays.reference).square().reciprocal()
    squared = (pool.mean(1) - arrays.half_a) * (pool.mean(1) - arrays.half_b)
    value, error = ratio_of_sums(squared * weight, pool.var(1) / pool.shape[1] * weight)
    return value - 1, error


def _has_equal_frame(one: Tensor, other: Tensor) -> bool:
    """True if two samples are equal in a whole frame that is not constant."""
    equal = (one == other).flatten(1).all(1)
    return bool((equal & (one.flatten(1).std(1) > 0)).any())
