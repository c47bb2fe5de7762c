"""Are the stored samples independent: of each other, of other pixels and frames, of references?"""

from __future__ import annotations

from itertools import combinations

import torch

from rlbench.checks.finding import Finding, fine, odd, wrong
from rlbench.checks.lint import noise_statistics
from rlbench.checks.lint.clip_arrays import ClipArrays

ALIKE = 0.05  # correlation from which on two are not independent; a tenth of it is ours' scatter
MUCH = 0.15
SIGMAS = 5.0  # standard errors that a correlation must be away from what independence gives
COMMON = 0.3  # excess of the error of the mean over what the samples' scatter predicts
SHARED = 0.01  # correlation of samples with the difference of the halves; 64 spp shared give 0.09
OFF = 0.03  # of the reference's mean, that the samples' mean may be off


def samples(footage: ClipArrays) -> Finding:
    """Are the samples of a pixel independent of each other?"""
    check, told = "samples", []
    for kind, pool in footage.pools.items():
        slots = range(pool.shape[1])
        if len(slots) < 2:
            told.append(f"pool {kind} has one sample")
            continue
        twins = [f"{i} and {j}" for i, j in combinations(slots, 2) if _same(pool[:, i], pool[:, j])]
        if twins:
            return wrong(check, f"pool {kind}: equal samples: {', '.join(twins[:4])}", RESEED)
        share, expected = noise_statistics.bounded(pool), -1 / (len(slots) - 1)
        pairs = {
            (i, j): noise_statistics.correlation(share[:, i], share[:, j])
            for i, j in combinations(slots, 2)
        }
        worst = max(pairs, key=lambda pair: pairs[pair][0])
        excess, error = pairs[worst][0] - expected, pairs[worst][1]
        if excess > max(ALIKE, SIGMAS * error):
            what = f"pool {kind}: samples {worst[0]} and {worst[1]} correlate by {excess:.2f}"
            return (wrong if excess > MUCH else odd)(check, what, RESEED)
        common, error = _common(footage, kind)
        if common > max(COMMON, 3 * error):
            what = (
                f"pool {kind}: their mean errs {1 + common:.1f} times as much as their scatter says"
            )
            return wrong(check, f"{what}, so all share some noise", RESEED)
        told.append(
            f"pool {kind}: pairs correlate by at most {excess:.3f} +- {pairs[worst][1]:.3f}"
        )
    return fine(check, "; ".join(told))


RESEED = "trace each sample with a seed of its own, unfiltered"


def neighbours(footage: ClipArrays) -> Finding:
    """Is the noise of a pixel independent of that of the next pixel, and of the next frame?"""
    check, told = "noise pattern", []
    for kind, pool in footage.pools.items():
        share = noise_statistics.bounded(pool)
        looks = {
            "the pixel to the right": (share[..., 1:], share[..., :-1]),
            "the pixel below": (share[..., 1:, :], share[..., :-1, :]),
            "the next frame": (share[1:], share[:-1]),
        }
        for where, (one, other) in looks.items():
            if not one.numel():
                continue
            found, error = noise_statistics.correlation(one.flatten(0, 1), other.flatten(0, 1))
            told.append(f"{found:.3f} with {where}")
            if found > max(ALIKE, SIGMAS * error):
                what = f"pool {kind}: noise correlates by {found:.2f} with {where}"
                return (wrong if found > MUCH else odd)(check, what, PATTERN[where])
    return fine(check, ", ".join(told))


FILTERED = "use a box filter of one pixel, no denoiser and no upscaling"
PATTERN = {
    "the pixel to the right": FILTERED,
    "the pixel below": FILTERED,
    "the next frame": "let the seed depend on the frame",
}


def seeds(footage: ClipArrays) -> Finding:
    """Are the samples independent of the reference?

    The difference of the halves is all noise, of mean zero: nothing that is independent of both
    can correlate with it, whatever its distribution; a sample that is in one half does. Samples
    that are in both are told by `rlbench.checks.lint.reference.halves`.
    """
    check, told = "seeds", []
    apart = footage.half_a - footage.half_b
    apart = (apart / noise_statistics.level(apart.abs())).clamp(
        -2, 2
    )  # fireflies would hide all others
    for kind, pool in footage.pools.items():
        share = pool / (pool + noise_statistics.level(pool.mean(1))[:, None])
        share = share - noise_statistics.level(share.mean(1))[:, None]
        looks = {f"sample {slot}": share[:, slot] for slot in range(pool.shape[1])}
        found = {k: noise_statistics.correlation(v, apart) for k, v in looks.items()}
        found["their mean"] = noise_statistics.correlation(share.mean(1), apart)
        worst = max(found, key=lambda name: abs(found[name][0]) / max(found[name][1], 1e-9))
        value, error = found[worst]
        if abs(value) > max(SHARED, 4 * error):
            half = "A" if value > 0 else "B"
            what = (
                f"pool {kind}: {worst} correlates by {abs(value):.3f} with the noise of half {half}"
            )
            remedy = (
                "trace pool and reference with seeds that never meet, or methods see the answer"
            )
            return wrong(check, what, remedy)
        told.append(f"pool {kind}: {value:+.3f} +- {error:.3f} with the reference's noise at most")
    return fine(check, "; ".join(told))


def brightness(footage: ClipArrays) -> Finding:
    """Is the mean of the samples that of the reference?"""
    check, told = "brightness", []
    for kind, pool in footage.pools.items():
        value, error = noise_statistics.ratio(pool.mean(1), footage.reference)
        told.append(f"pool {kind}: {value:.3f} +- {error:.3f} of the reference's mean")
        if abs(value - 1) > max(OFF, SIGMAS * error):
            remedy = "the same exposure, clamping, encoding and light paths for both"
            return wrong(check, told[-1], remedy)
    return fine(check, "; ".join(told))


def _common(footage: ClipArrays, kind: str) -> tuple[float, float]:
    """Excess of the mean's squared error over the variance that the samples' scatter predicts.

    (m - A)(m - B) is an unbiased estimate of the error of the mean m, for the halves are
    independent. m is brought to the reference's brightness first, which is another check's.
    """
    pool = noise_statistics.alike(footage.pools[kind], footage.reference)
    weight = noise_statistics.level(footage.reference).square().reciprocal()
    error = (pool.mean(1) - footage.half_a) * (pool.mean(1) - footage.half_b)
    value, scatter = noise_statistics.ratio(error * weight, pool.var(1) / pool.shape[1] * weight)
    return value - 1, scatter


def _same(one: torch.Tensor, other: torch.Tensor) -> bool:
    """Are two samples equal in some whole frame, though there is something to see?"""
    equal = (one == other).flatten(1).all(1)
    return bool((equal & (one.flatten(1).std(1) > 0)).any())
