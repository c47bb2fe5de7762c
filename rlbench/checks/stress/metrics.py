"""Section `metrics`: every installed metric gives the expected score for a broken image.

Each metric scores pairs of an image and its reference: equal, slightly noisy, black, negative,
overflowing, and with one or all pixels NaN. A broken image must never score as well as an equal
one. A score that is NaN is not a wrong answer, but degrades the verdict: the row has no number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rlbench import registry
from rlbench.checks.result import CheckResult, Limits, Verdict, not_applicable
from rlbench.checks.stress.section import SuiteSection, report_exception

if TYPE_CHECKING:
    from metrics.metric import Metric

SIZE, TINY = (192, 176), (7, 9)  # height and width; MS-SSIM needs sides above 160 pixels
SEED = 11
NOISE = 0.01  # standard deviation of the slightly noisy image, in display whites
OVERFLOW = 1e38  # its square is infinite in float32
PERFECT = 1e-6  # largest error of an equal image, relative to the score of a black one
Broken = Callable[[Tensor], Tensor]  # from the reference [n 3 h w] to an image


def _with_nan_pixel(reference: Tensor) -> Tensor:
    image = reference.clone()
    image[..., 5, 3] = math.nan
    return image


BROKEN: dict[str, Broken] = {
    "black": torch.zeros_like,
    "anti-correlated": lambda reference: reference.amax() - reference,
    "overflow": lambda reference: torch.full_like(reference, OVERFLOW),
    "infinite": lambda reference: torch.full_like(reference, math.inf),
    "nan-pixel": _with_nan_pixel,
    "nan": lambda reference: torch.full_like(reference, math.nan),
}
FINITE = ("black", "anti-correlated", "overflow")  # a count of non-finite pixels is 0 on these


@dataclass(frozen=True)
class StressedMetric:
    """A metric with its score of an equal image and of a slightly noisy one."""

    name: str
    metric: Metric
    equal: float = field(default=math.nan)
    noisy: float = field(default=math.nan)

    def score(self, broken: Broken, size: tuple[int, int] = SIZE) -> float:
        """The score of a broken copy of the reference; in a clip of three frames."""
        compared = None
        for reference in _references(*size):
            compared = self.metric.compare(
                broken(reference), reference, reference, static=True, previous=compared
            )
        scores = self.metric.at(*size).score(compared)
        if tuple(scores.shape) != (1,):
            raise ValueError(f"the score of one image has shape {list(scores.shape)}, not [1]")
        return float(scores[0])

    def error(self, score: float) -> float:
        """How much worse a score is than that of an equal image; below 0 where it is better."""
        if self.metric.direction == "higher":
            return self.equal - score
        difference = score - self.equal
        return difference if self.metric.direction == "lower" else abs(difference)


def _run(is_quick: bool) -> Iterator[CheckResult]:
    for name in registry.list_plugins("metrics"):
        try:
            metric = registry.load_plugin("metrics", name)
        except Exception as error:  # third-party code may raise anything
            yield report_exception("", f"{name}-import", error)
        else:
            yield from stress_metric(name, metric) if metric.scored_by_run else ()


def stress_metric(name: str, metric: Metric) -> Iterator[CheckResult]:
    """One result for each pair of images; only one if an equal image has no finite score."""
    if "counts" in metric.needs or metric.scores_previous:
        found = (
            "scores the image of the frame before, not this one"
            if metric.scores_previous
            else "says where samples went, not how good an image is"
        )
        yield not_applicable(f"{name}-identical", found)
        return
    stressed = StressedMetric(name, metric)
    try:
        equal, noisy = stressed.score(torch.clone), stressed.score(_add_noise)
        tiny = stressed.score(torch.clone, TINY)
    except Exception as error:  # third-party code may raise anything
        yield report_exception("", f"{name}-identical", error)
        return
    stressed = StressedMetric(name, metric, equal, noisy)
    yield _judge_equal(stressed)
    if not math.isfinite(equal):
        return
    yield _judge_tiny(stressed, tiny)
    scores: dict[str, float] = {}
    for test, broken in BROKEN.items():
        try:
            scores[test] = stressed.score(broken)
        except Exception as error:  # third-party code may raise anything
            yield report_exception("", f"{name}-{test}", error)
    counts_nonfinite = all(stressed.error(scores.get(test, math.nan)) == 0 for test in FINITE)
    for test, score in scores.items():
        yield _judge_broken(stressed, test, score, counts_nonfinite and test in FINITE)


def _judge_equal(stressed: StressedMetric) -> CheckResult:
    """An equal image has error 0, or the highest score."""
    equal, noisy = stressed.equal, stressed.error(stressed.noisy)
    is_best = abs(equal) <= PERFECT or stressed.metric.direction == "higher"
    if math.isfinite(equal) and is_best and noisy >= 0:
        return _result(stressed, "identical", Verdict.PASSED, equal)
    found = f"an equal image scores {equal:g}, a slightly noisy one {stressed.noisy:g}"
    remedy = "give an equal image the best score: 0, or the highest one"
    return _result(stressed, "identical", Verdict.FAILED, equal, found, remedy)


def _judge_tiny(stressed: StressedMetric, score: float) -> CheckResult:
    """At a size for which a metric is undefined, its score is NaN and its convention says why."""
    test, height, width = "tiny", *TINY
    if not math.isnan(score):
        is_equal = abs(stressed.error(score)) <= PERFECT
        verdict = Verdict.PASSED if is_equal else Verdict.FAILED
        found = "" if is_equal else f"an equal image of {width}x{height} pixels scores {score:g}"
        remedy = "" if is_equal else "return NaN at sizes for which the metric is undefined"
        return _result(stressed, test, verdict, score, found, remedy)
    convention = stressed.metric.at(height, width).convention
    if convention != stressed.metric.convention:
        found = f"nan: {convention}"
        return _result(stressed, test, Verdict.PASSED, score, found)
    remedy = "say in `convention` why it is undefined, through Metric.fit"
    return _result(stressed, test, Verdict.WARNING, score, "nan without a reason", remedy)


def _judge_broken(
    stressed: StressedMetric, test: str, score: float, is_not_counted: bool
) -> CheckResult:
    if is_not_counted:
        found = "counts only pixels that are not finite"
        return _result(stressed, test, Verdict.PASSED, score, found)
    if math.isnan(score):
        remedy = "return the score of the largest error, so that the row has a number"
        return _result(stressed, test, Verdict.WARNING, score, "the score is nan", remedy)
    error, noisy = stressed.error(score), stressed.error(stressed.noisy)
    if error <= 0 or (test != "nan-pixel" and error < noisy):
        found = (
            f"scores {score:g}; an equal image scores {stressed.equal:g}, "
            f"a slightly noisy one {stressed.noisy:g}"
        )
        remedy = "count pixels that are not finite as the largest error, and clip before squaring"
        return _result(stressed, test, Verdict.FAILED, score, found, remedy)
    if math.isinf(score):
        remedy = "clamp radiance before it is squared, so that the row has a number"
        return _result(stressed, test, Verdict.WARNING, score, "the score is infinite", remedy)
    return _result(stressed, test, Verdict.PASSED, score)


def _result(
    stressed: StressedMetric,
    test: str,
    verdict: Verdict,
    score: float,
    found: str = "",
    remedy: str = "",
) -> CheckResult:
    name, unit = f"{stressed.name}-{test}", stressed.metric.unit
    found = found or f"scores {score:.6g}{' ' + unit if unit else ''}"
    return CheckResult(name, verdict, found, remedy, score, Limits(unit=unit))


def _add_noise(reference: Tensor) -> Tensor:
    noise = torch.randn(reference.shape, generator=torch.Generator().manual_seed(SEED + 1))
    return (reference + NOISE * noise).clamp_min(0)


def _references(height: int, width: int) -> list[Tensor]:
    """Three frames [1 3 h w] of a smooth, moving pattern in [0, 0.8], darker than mid-grey."""
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    frames = [((rows + 3 * t) / 9).sin() * ((columns - 5 * t) / 7).cos() for t in (0, 1, 2)]
    channels = torch.tensor([0.8, 0.5, 0.3]).view(1, 3, 1, 1)
    return [(channels * (frame + 1).square() / 4).contiguous() for frame in frames]


SECTION = SuiteSection(_run)
