"""The section `metrics` finds metrics that take a broken image for a good one."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from metrics.metric import Metric
from rlbench import registry
from rlbench.checks.result import Verdict
from rlbench.checks.stress import metrics


def metric_of(score) -> Metric:
    """A metric of a plugin with a score of the image and the halves."""
    return Metric("toy", "", "lower", "linear", lambda c: score(c.image, c.half_a, c.half_b))


def squared_error(image, a, b):
    return (image - a).double().clamp(-6e4, 6e4).nan_to_num(6e4).square().mean((1, 2, 3))


def nan_as_zero(image, a, b):
    """Pixels that are not finite are ignored."""
    return squared_error(image.where(image.isfinite(), a), a, b)


def raising(image, a, b):
    if not image.isfinite().all():
        raise FloatingPointError("not finite")
    return squared_error(image, a, b)


def absolute_correlation(image, a, b):
    """The sign of the correlation is lost: a negative looks as good as the image."""
    pair = torch.stack([image.flatten(), a.flatten()]).double().nan_to_num(0.0, 0.0, 0.0)
    return 1 - torch.corrcoef(pair)[0, 1].abs().nan_to_num(0.0).view(1)


def verdicts(toy) -> dict[str, Verdict]:
    return {r.check: r.verdict for r in metrics.stress_metric("toy", toy)}


def names_with(verdict: Verdict, toy) -> set[str]:
    return {test for test, found in verdicts(toy).items() if found is verdict}


def test_a_sound_metric_passes():
    assert set(verdicts(metric_of(squared_error)).values()) == {Verdict.PASSED}


def test_a_metric_that_ignores_nan_fails():
    assert names_with(Verdict.FAILED, metric_of(nan_as_zero)) == {
        "toy-infinite",
        "toy-nan",
        "toy-nan-pixel",
    }


def test_a_metric_that_takes_a_negative_for_the_image_fails():
    assert "toy-anti-correlated" in names_with(Verdict.FAILED, metric_of(absolute_correlation))


def test_an_exception_is_a_failure_with_its_name():
    results = {result.check: result for result in metrics.stress_metric("toy", metric_of(raising))}
    assert results["toy-nan"].verdict is Verdict.FAILED
    assert results["toy-nan"].found.startswith("raised FloatingPointError: not finite")
    assert results["toy-black"].verdict is Verdict.PASSED


def test_a_score_that_is_nan_or_infinite_degrades():
    overflow = metric_of(lambda image, a, b: (image - a).square().mean((1, 2, 3)))
    assert names_with(Verdict.WARNING, overflow) == {
        *("toy-overflow", "toy-infinite", "toy-nan", "toy-nan-pixel")
    }


def test_a_metric_whose_best_score_is_not_that_of_an_equal_image_fails():
    assert "toy-identical" in names_with(
        Verdict.FAILED, metric_of(lambda *x: 3 - squared_error(*x))
    )


def test_a_metric_without_a_score_for_an_equal_image_has_one_failure():
    assert verdicts(metric_of(lambda image, a, b: image.new_full((1,), math.nan))) == {
        "toy-identical": Verdict.FAILED
    }


def test_a_score_of_another_shape_fails():
    toy = metric_of(lambda *x: squared_error(*x).view(1, 1))
    assert verdicts(toy) == {"toy-identical": Verdict.FAILED}


def test_a_metric_that_is_undefined_at_a_size_says_why():
    def at_size(image, a, b):
        return squared_error(image, a, b) * (math.nan if image.shape[2] < 11 else 1)

    toy = metric_of(at_size)
    assert verdicts(toy)["toy-tiny"] is Verdict.WARNING

    small = replace(toy, convention="undefined below 11 pixels")
    documented = replace(toy, fit=lambda height, width: small if height < 11 else toy)
    assert verdicts(documented)["toy-tiny"] is Verdict.PASSED


def test_every_installed_metric_passes():
    results = list(metrics.SECTION.run(True))
    tested = {result.check.rpartition("-")[0] for result in results}
    assert tested > set(registry.load_run_metrics())
    judge_no_image = {"effort_error", "effort_noise", "at_cap", "psnr_late"}  # or the one before
    skipped = {r.check.rpartition("-")[0] for r in results if r.verdict is Verdict.SKIPPED}
    assert skipped == judge_no_image
    assert {r.verdict for r in results} == {Verdict.PASSED, Verdict.SKIPPED}
