"""Section `budgets`: a method runs at every budget, density and image size.

Budgets run from 0 to more than the pool has. Densities that no method plans put all samples in one
pixel, in half the image, or span the range of floats; they replace the density of adaptive methods.
Sizes run from one pixel to 1080p.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import torch

from rlbench.checks.display import to_display
from rlbench.checks.result import CheckResult, Limits, failed, judge, not_applicable, passed
from rlbench.checks.stress.allocation import DENSITIES
from rlbench.checks.stress.section import MethodSection, StressedMethod, attempt, report_exception
from rlbench.checks.stress.wrappers import PlannedDensity
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.method import Method
from rlbench.run import FrameResult
from rlbench.sampling import BudgetError

SEED = 8
SMALL = (48, 64)  # height and width, where the size does not matter
SIZES = ((1, 1), (1, 17), (7, 9), (77, 123))
FULL_HD = (1080, 1920)
POOL_SPP = 8
FULL_HD_POOL_SPP = 4  # to save memory
ABOVE_POOL = POOL_SPP + 1
BUDGETS = (0.0, 0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0)
QUICK_BUDGETS = (0.0, 2.0, 8.0)
QUICK_DENSITIES = ("half", "1e38")
FRAMES = {False: 4, True: 2}  # quick or not
NO_WRONG_PIXELS = Limits(good=0.0, fair=0.0, unit="wrong pixels")
LOSS = Limits(good=0.1, fair=1.0, unit="dB")  # of PSNR, when the budget grows
RISING_FROM = 1.0  # spp; below, some pixels have no sample and PSNR is a matter of luck
REMEDY = "return a finite float32 image [n 3 h w] for any budget, density and size"
LOSS_REMEDY = "train at these budgets too, or give the network the sample counts"


def _run(stressed: StressedMethod, is_quick: bool) -> Iterator[CheckResult]:
    frames = FRAMES[is_quick]
    yield from _stress_budgets(stressed, is_quick)
    yield attempt(stressed.name, "spp-above-pool", lambda: _exceed_pool(stressed))
    for density in QUICK_DENSITIES if is_quick else DENSITIES:
        test = f"density-{density}"
        if stressed.traits.adaptive:
            method = PlannedDensity(stressed.method, DENSITIES[density])
            yield _run_test(stressed, test, SMALL, frames, method)
        else:
            yield not_applicable(test, "the method samples uniformly")
    for height, width in SIZES:
        yield _run_test(stressed, f"size-{width}x{height}", (height, width), frames)
    if not is_quick:
        yield _run_full_hd(stressed)


def _stress_budgets(stressed: StressedMethod, is_quick: bool) -> Iterator[CheckResult]:
    """A result per budget, then one on whether more samples give a better image."""
    scores: dict[float, float] = {}
    for spp in QUICK_BUDGETS if is_quick else BUDGETS:
        test = f"spp-{spp:g}"
        if reason := stressed.traits.unsupported_reason(spp):
            yield not_applicable(test, reason)
            continue
        try:
            frames = _frames(stressed, SMALL, FRAMES[is_quick], spp)
        except Exception as error:  # whatever a method raises is its result
            yield report_exception(stressed.name, test, error)
            continue
        if spp >= RISING_FROM:
            scores[spp] = _psnr(frames)
        yield _judge_frames(test, frames, SMALL, spp)
    if len(scores) > 1:
        yield _judge_scores(scores)


def _exceed_pool(stressed: StressedMethod) -> CheckResult:
    """The core refuses a budget that the pool cannot pay for, whatever the method plans."""
    test = "spp-above-pool"
    try:
        _frames(stressed, SMALL, 1, ABOVE_POOL)
    except BudgetError as error:
        return passed(test, f"refused: {error}")
    found = f"{ABOVE_POOL} spp ran with a pool of {POOL_SPP}"
    return failed(test, found, "leave the budget to rlbench.sampling")


def _run_full_hd(stressed: StressedMethod) -> CheckResult:
    """One frame at 1080p; takes up to half a minute, so it is left to one row of a family."""
    height, width = FULL_HD
    test = f"size-{width}x{height}"
    family, _, variant = stressed.name.partition("/")
    if variant:
        return not_applicable(test, f"runs for '{family}', to save time")
    return _run_test(stressed, test, FULL_HD, 1)


def _run_test(
    stressed: StressedMethod,
    test: str,
    size: tuple[int, int],
    frames: int,
    method: Method | None = None,
) -> CheckResult:
    """Run some frames of a size at the default budget and judge them."""
    spp = stressed.default_spp

    def run() -> CheckResult:
        return _judge_frames(test, _frames(stressed, size, frames, spp, method), size, spp)

    return attempt(stressed.name, test, run)


def _frames(
    stressed: StressedMethod,
    size: tuple[int, int],
    frames: int,
    spp: float,
    method: Method | None = None,
) -> list[FrameResult]:
    pool_spp = FULL_HD_POOL_SPP if size == FULL_HD else POOL_SPP
    clip = procedural_clip(SEED, Size(1, *size), frames, pool_spp, device=stressed.device)
    return stressed.run(clip, spp, method)


def _judge_frames(
    test: str, frames: list[FrameResult], size: tuple[int, int], spp: float
) -> CheckResult:
    """Judge the frame with most wrong pixels."""
    wrong, found = max((_count_wrong(frame, size, spp) for frame in frames), key=lambda w: w[0])
    return judge(test, wrong, NO_WRONG_PIXELS, found, REMEDY)


def _count_wrong(result: FrameResult, size: tuple[int, int], spp: float) -> tuple[int, str]:
    """Number of wrong pixels of an image, and what is wrong; all of them if its form is wrong."""
    pixels = size[0] * size[1]
    expected, image = (1, 3, *size), result.image
    if tuple(image.shape) != expected or image.dtype != torch.float32:
        return pixels, f"expected float32 {list(expected)}, found {image.dtype} {list(image.shape)}"
    drawn, paid = int(result.samples.counts.sum()), round(spp * pixels)
    if drawn != paid:
        return pixels, f"expected {paid} samples, found {drawn}"
    wrong = pixels - int(image.isfinite().all(1).sum())
    return wrong, f"{wrong} pixels of frame {result.frame.index} are not finite" if wrong else ""


def _judge_scores(scores: dict[float, float]) -> CheckResult:
    """Judge the largest loss of PSNR from a budget to the next larger one."""
    losses = {f"{a:g} to {b:g}": scores[a] - scores[b] for a, b in pairwise(scores)}
    worst = max(losses, key=lambda step: losses[step])
    found = ", ".join(f"{spp:g} spp: {score:.2f} dB" for spp, score in scores.items())
    loss = max(0.0, losses[worst])
    found = f"largest loss from {worst} spp; {found}" if loss else found
    return judge("more-samples", loss, LOSS, found, LOSS_REMEDY)


def _psnr(frames: list[FrameResult]) -> float:
    """PSNR of all frames in dB, peak 1, clipped sRGB; a value that is not finite counts as 1."""
    errors = []
    for frame in frames:
        error = to_display(frame.image) - to_display(frame.frame.reference.mean)
        errors.append(error.square().nan_to_num(1.0).mean(dtype=torch.float64))
    return float(-10 * torch.stack(errors).mean().clamp_min(1e-10).log10())


SECTION = MethodSection(_run)
