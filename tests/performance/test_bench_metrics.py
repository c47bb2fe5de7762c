"""Speed of the metrics against other libraries, which the table shows as ratios in parentheses."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import pytorch_msssim
import torch
from kornia.metrics import ssim as kornia_ssim
from torchmetrics.functional.image import (
    multiscale_structural_similarity_index_measure,
    structural_similarity_index_measure,
)

from metrics.metric import Comparison
from metrics.ssim import ms_ssim, ssim
from rlbench import registry

Similarity = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
SSIM: dict[str, Similarity] = {
    "rlbench": ssim,
    "pytorch_msssim": lambda x, y: pytorch_msssim.ssim(x, y, data_range=1.0),
    "torchmetrics": lambda x, y: structural_similarity_index_measure(x, y, data_range=1.0),
    "kornia": lambda x, y: kornia_ssim(x, y, window_size=11),
}
MS_SSIM: dict[str, Similarity] = {
    "rlbench": ms_ssim,
    "pytorch_msssim": lambda x, y: pytorch_msssim.ms_ssim(x, y, data_range=1.0),
    "torchmetrics": lambda x, y: multiscale_structural_similarity_index_measure(
        x, y, data_range=1.0
    ),
}


def pair(h: int, w: int) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(0)
    reference = torch.rand(1, 3, h, w, generator=g)
    return (reference + 0.1 * torch.randn(1, 3, h, w, generator=g)).clamp(0, 1), reference


@pytest.mark.parametrize("name", SSIM)
@pytest.mark.benchmark(group="SSIM, 1x3x1080x1920")
def test_ssim(benchmark, name):
    with torch.inference_mode():
        score = benchmark.pedantic(SSIM[name], pair(1080, 1920), rounds=5, warmup_rounds=1)
    assert score.isfinite().all()


@pytest.mark.parametrize("name", MS_SSIM)
@pytest.mark.benchmark(group="MS-SSIM, 1x3x1080x1920")
def test_ms_ssim(benchmark, name):
    with torch.inference_mode():
        score = benchmark.pedantic(MS_SSIM[name], pair(1080, 1920), rounds=5, warmup_rounds=1)
    assert score.isfinite().all()


@pytest.mark.parametrize("name", sorted(registry.load_run_metrics()))
@pytest.mark.benchmark(group="metrics of a run, 1x3x1080x1920, transforms included")
def test_metric_of_a_run(benchmark, name):
    metric = registry.load_run_metrics()[name].at(1080, 1920)
    image, reference = pair(1080, 1920)
    given = {"counts": torch.ones(1, 1, 1080, 1920), "static": True}

    def score() -> torch.Tensor:
        before = Comparison(reference, image, reference, **given)
        return metric.score(Comparison(image, reference, image, previous=before, **given))

    with torch.inference_mode():
        benchmark.pedantic(score, rounds=3, warmup_rounds=1)
