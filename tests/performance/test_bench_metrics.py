"""Speed of the metrics against other libraries, which the table shows as ratios in parentheses."""

from __future__ import annotations

import pytest
import torch

from metrics.metric import Comparison
from rlbench import registry
from tests.performance.metric_speed import MS_SSIM, SSIM, image_pair


@pytest.mark.parametrize("name", SSIM)
@pytest.mark.benchmark(group="SSIM, 1x3x1080x1920")
def test_ssim(benchmark, name):
    with torch.inference_mode():
        score = benchmark.pedantic(SSIM[name], image_pair(1080, 1920), rounds=5, warmup_rounds=1)
    assert score.isfinite().all()


@pytest.mark.parametrize("name", MS_SSIM)
@pytest.mark.benchmark(group="MS-SSIM, 1x3x1080x1920")
def test_ms_ssim(benchmark, name):
    with torch.inference_mode():
        score = benchmark.pedantic(MS_SSIM[name], image_pair(1080, 1920), rounds=5, warmup_rounds=1)
    assert score.isfinite().all()


@pytest.mark.parametrize("name", sorted(registry.load_run_metrics()))
@pytest.mark.benchmark(group="metrics of a run, 1x3x1080x1920, transforms included")
def test_metric_of_a_run(benchmark, name):
    metric = registry.load_run_metrics()[name].at(1080, 1920)
    image, reference = image_pair(1080, 1920)
    given = {"counts": torch.ones(1, 1, 1080, 1920), "static": True}

    def score() -> torch.Tensor:
        before = Comparison.of(reference, image, reference, **given)
        return metric.score(Comparison.of(image, reference, image, previous=before, **given))

    with torch.inference_mode():
        benchmark.pedantic(score, rounds=3, warmup_rounds=1)
