"""Samples: are they independent of each other, of other pixels and frames, and of the reference?"""

from __future__ import annotations

from itertools import combinations

from torch import Tensor

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.noise_statistics import (
    bounded_noise,
    correlate,
    local_mean,
    match_brightness,
    ratio_of_sums,
)
from rlbench.checks.lint.reference import has_one_reference
from rlbench.checks.result import CheckResult, failed, passed, warning

MAX_CORRELATION = 0.05  # of independent samples; our clips scatter by a tenth of it
FAIL_CORRELATION = 0.15  # from which on a check fails instead of warning
SIGMAS = 5.0  # standard errors by which a correlation must deviate from independence
MAX_COMMON_NOISE = 0.3  # excess of the error of the mean over that predicted from the samples
MAX_SHARED = 0.01  # correlation of samples with the difference of the halves; 64 shared spp give
# 0.09
MAX_BRIGHTNESS_ERROR = 0.03  # of the samples' mean, relative to the reference's mean
RESEED = "render each sample with a different seed, unfiltered"
NO_FILTER = "use a box filter of one pixel, no denoiser and no upscaling"
PATTERN_REMEDIES = {
    "the pixel to the right": NO_FILTER,
    "the pixel below": NO_FILTER,
    "the next frame": "make the seed depend on the frame",
}


def check_samples(arrays: ClipArrays) -> CheckResult:
    """Are the samples of a pixel independent of each other?"""
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
    """Is the noise of a pixel independent of that of the next pixel, and of the next frame?"""
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
    """Are the samples independent of the reference?

    The difference of the halves is pure noise with mean zero: a sample that is independent of both
    cannot correlate with it, whatever its distribution; a sample that is part of one half does.
    Samples that are part of both are found by `rlbench.checks.lint.reference.check_halves`.
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
    """Does the mean of the samples equal that of the reference?"""
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
    """Are two samples equal in a whole frame that is not constant?"""
    equal = (one == other).flatten(1).all(1)
    return bool((equal & (one.flatten(1).std(1) > 0)).any())
