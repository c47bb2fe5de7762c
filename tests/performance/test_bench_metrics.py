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
    """On the third frame of a clip in which nothing moves: flicker reads the two before it."""
    metric = registry.load_run_metrics()[name].at(1080, 1920)
    image, reference = image_pair(1080, 1920)
    counts = torch.ones(1, 1, 1080, 1920)

    def score() -> torch.Tensor:
        frame = None
        for each, halves in ((image, reference), (reference, image), (image, reference)):
            given = {"static": True, "counts": counts, "max_samples": 8, "previous": frame}
            frame = Comparison.of(each, halves, each, **given)
        return metric.score(frame)

    with torch.inference_mode():
        benchmark.pedantic(score, rounds=3, warmup_rounds=1)
