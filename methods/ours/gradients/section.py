"""The section `gradients` of `rlbench stress`: estimated against true gradients of a sampler."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from methods.ours.gradients.estimators import (
    ESTIMATORS,
    Estimator,
    Measurement,
    measure,
)
from methods.ours.gradients.exact_gradient import DENOISERS
from methods.ours.gradients.measure import (
    RATIO_KINDS,
    SIDES,
    Saturation,
    measure_saturation,
)
from rlbench.checks.result import CheckResult, Limits, judge, not_applicable
from rlbench.checks.stress.section import SuiteSection

# A step along the estimate achieves this share of the steepest descent: 0.71 is an angle of 45
# degrees, where half of the squared gradient is lost.
DIRECTION = Limits(good=0.95, fair=0.71, unit="cosine")
# A wrong length is a wrong learning rate, which Adam removes as long as it is the same everywhere.
SCALE = Limits(good=1.25, fair=2.5, unit="factor")
# Frames whose mean gradient has as much noise as signal; `ours` is trained on 6000.
NOISE = Limits(good=100, fair=1000, unit="frames")
# An action outside the clip range has no gradient if its advantage pushes it further out.
CLIPPED = Limits(good=0.2, fair=0.5, unit="share")

FULL_DRAWS, QUICK_DRAWS = 128, 32  # independent gradients of each measurement
QUICK_DENOISERS = ("no filter", "count-weighted filter")
QUICK_SIDES = (8, 32)  # of the images whose ratios are measured
ADAM_STEP = "Adam"  # the step whose ratios are judged


class Band(NamedTuple):
    """Budgets that share a verdict: the worst one decides."""

    name: str
    budgets: Sequence[float]  # samples per pixel
    quick: Sequence[float]


BANDS = (
    Band("below-1-spp", (0.25, 0.5), (0.5,)),
    Band("1-to-4-spp", (1, 2, 4), (4,)),
    Band("8-to-64-spp", (8, 64), ()),
)


def run_gradients(quick: bool) -> Iterator[CheckResult]:
    """Direction, scale and noise of each estimator that trains `ours`, then saturated ratios."""
    for name, estimator in ESTIMATORS.items():
        if estimator.trains_ours:
            yield from judge_estimator(name, estimator, quick)
    sides = QUICK_SIDES if quick else SIDES
    measured = [saturation for side in sides for saturation in measure_saturation(side)]
    for ratio in RATIO_KINDS:
        yield _judge_ratio(ratio, [s for s in measured if s.ratio == ratio])


def judge_estimator(name: str, estimator: Estimator, quick: bool = True) -> Iterator[CheckResult]:
    """The results of one estimator, over all denoisers and bands of budgets."""
    denoisers = QUICK_DENOISERS if quick else tuple(DENOISERS)
    for band in BANDS:
        test = f"{name.replace(' ', '-')}-{band.name}"
        budgets = [b for b in (band.quick if quick else band.budgets) if b >= estimator.min_spp]
        if not budgets:
            if band.quick or not quick:
                reason = "needs a sample in every pixel; not trained below 1 spp"
                yield not_applicable(test, reason)
            continue
        draws = (QUICK_DRAWS if quick else FULL_DRAWS) * estimator.noise_factor
        measured = [
            measure(name, denoiser, spp, draws, estimator)
            for denoiser in denoisers
            for spp in budgets
        ]
        yield _judge_direction(test, measured, estimator.remedy)
        if estimator.has_scale:
            yield _judge_scale(test, measured)
        yield _judge_noise(test, measured)


def _judge_direction(test: str, measured: Sequence[Measurement], remedy: str) -> CheckResult:
    resolved = [m for m in measured if m.statistics.is_resolved]
    test = f"{test}-direction"
    if not resolved:
        draws = measured[0].draws
        return not_applicable(test, f"hidden by noise in the mean of {draws} gradients")
    worst = min(resolved, key=lambda m: m.statistics.cosine.value)
    found = f"cosine {worst.statistics.cosine} {_where(worst)}"
    return judge(test, worst.statistics.cosine.value, DIRECTION, found, remedy)


def _judge_scale(test: str, measured: Sequence[Measurement]) -> CheckResult:
    worst = max(measured, key=lambda m: _factor(m.statistics.scale.value))
    found = f"{worst.statistics.scale} times the true length {_where(worst)}"
    remedy = "divide the estimate by its scale, or keep the learning rate per budget"
    figure = _factor(worst.statistics.scale.value)
    return judge(f"{test}-scale", figure, SCALE, found, remedy)


def _judge_noise(test: str, measured: Sequence[Measurement]) -> CheckResult:
    worst = max(measured, key=lambda m: m.statistics.frames_needed)
    frames = worst.statistics.frames_needed
    found = f"the mean of {frames:.0f} gradients has as much noise as signal {_where(worst)}"
    remedy = "subtract a baseline, credit errors locally, or average more frames per step"
    return judge(f"{test}-noise", frames, NOISE, found, remedy)


def _judge_ratio(ratio: str, measured: Sequence[Saturation]) -> CheckResult:
    steps = [s for s in measured if s.step.startswith(ADAM_STEP)]
    sizes = ", ".join(f"{s.clipped:.0%} at {s.side}x{s.side}" for s in steps)
    remedy = "use one ratio per block or pixel: AppoSettings(joint_ratio=False)"
    found = f"outside the clip range after one Adam step of 0.001: {sizes} pixels"
    worst = max(s.clipped for s in steps)
    return judge(f"ratio-{ratio}", worst, CLIPPED, found, remedy)


def _factor(scale: float) -> float:
    """How many times too long or too short; infinite for the wrong sign."""
    return max(scale, 1 / scale) if scale > 0 else float("inf")


def _where(measurement: Measurement) -> str:
    return f"at {measurement.spp:g} spp, {measurement.denoiser}"


SECTION = SuiteSection(run_gradients)
