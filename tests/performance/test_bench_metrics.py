"""Time of each metric of a run; `metric_speed` compares SSIM and MS-SSIM with other libraries."""

from __future__ import annotations

import pytest
import torch

from metrics.metric import Comparison
from rlbench import registry
from tests.performance.metric_speed import image_pair


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
