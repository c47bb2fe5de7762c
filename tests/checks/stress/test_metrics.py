"""The section `metrics` finds metrics that take a broken image for a good one."""

from __future__ import annotations

import math

import pytest
import torch

from metrics.metric import Metric
from rlbench import registry
from rlbench.checks.result import Verdict
from rlbench.checks.stress import metrics

PASSED, WARNING, FAILED = Verdict.PASSED, Verdict.WARNING, Verdict.FAILED


def squared_error(image, a):
    return (image - a).double().clamp(-6e4, 6e4).nan_to_num(6e4).square().mean((1, 2, 3))


def raising(image, a):
    if not image.isfinite().all():
        raise FloatingPointError("not finite")
    return squared_error(image, a)


def absolute_correlation(image, a):
    """The sign of the correlation is lost: a negative looks as good as the image."""
    pair = torch.stack([image.flatten(), a.flatten()]).double().nan_to_num(0.0, 0.0, 0.0)
    return 1 - torch.corrcoef(pair)[0, 1].abs().nan_to_num(0.0).view(1)


def undefined_below_11_pixels(image, a):
    return squared_error(image, a) * (math.nan if image.shape[2] < 11 else 1)


NONFINITE = ("infinite", "nan", "nan-pixel")
SCORES = {  # of the image and a reference, and what does not pass
    "sound": (squared_error, {}),
    "ignores what is not finite": (
        lambda image, a: squared_error(image.where(image.isfinite(), a), a),
        dict.fromkeys(NONFINITE, FAILED),
    ),
    "is nan or infinite": (
        lambda image, a: (image - a).square().mean((1, 2, 3)),
        dict.fromkeys(("overflow", *NONFINITE), WARNING),
    ),
    "raises": (raising, dict.fromkeys(NONFINITE, FAILED)),
    "takes a negative for the image": (absolute_correlation, {"anti-correlated": FAILED}),
    "is undefined at a size": (undefined_below_11_pixels, {"tiny": WARNING}),
}


def stress(score) -> dict[str, metrics.CheckResult]:
    """The results for a metric of a plugin."""
    toy = Metric("toy", "", "lower", "linear", lambda c: score(c.image, c.half_a))
    return {r.check.removeprefix("toy-"): r for r in metrics.stress_metric("toy", toy)}


@pytest.mark.parametrize(("score", "faults"), SCORES.values(), ids=SCORES)
def test_a_metric_fails_the_images_that_it_takes_for_good_ones_alone(score, faults):
    found = {test: result.verdict for test, result in stress(score).items()}
    assert found == dict.fromkeys(("identical", "tiny", *metrics.BROKEN), PASSED) | faults


def test_an_exception_is_reported_with_its_name():
    assert stress(raising)["nan"].found.startswith("raised FloatingPointError: not finite")


def test_a_metric_whose_best_score_is_not_that_of_an_equal_image_fails():
    assert stress(lambda *x: 3 - squared_error(*x))["identical"].verdict is FAILED


@pytest.mark.parametrize(
    "score",
    [lambda image, a: image.new_full((1,), math.nan), lambda *x: squared_error(*x).view(1, 1)],
    ids=["nan", "another shape"],
)
def test_a_metric_without_a_score_for_an_equal_image_has_one_failure(score):
    (result,) = stress(score).values()
    assert (result.check, result.verdict) == ("toy-identical", FAILED)


def test_every_installed_metric_passes():
    results = list(metrics.SECTION.run(True))
    tested = {result.check.rpartition("-")[0] for result in results}
    assert tested > set(registry.load_run_metrics())
    judge_no_image = {"effort_error", "effort_noise", "at_cap", "psnr_late"}  # or the one before
    skipped = {r.check.rpartition("-")[0] for r in results if r.verdict is Verdict.SKIPPED}
    assert skipped == judge_no_image
    assert {r.verdict for r in results} == {PASSED, Verdict.SKIPPED}
