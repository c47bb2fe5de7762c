"""Speed of the metrics against kornia."""

from __future__ import annotations

import pytest
import torch

from metrics.image import ms_ssim, psnr


def pair(h, w):
    g = torch.Generator().manual_seed(0)
    return torch.rand(1, 3, h, w, generator=g), torch.rand(1, 3, h, w, generator=g)


@pytest.mark.benchmark(group="psnr")
def test_psnr_1080p(benchmark):
    benchmark(psnr, *pair(1080, 1920))


@pytest.mark.benchmark(group="ms-ssim")
def test_ms_ssim_ours(benchmark):
    benchmark(ms_ssim, *pair(192, 192))


@pytest.mark.benchmark(group="ms-ssim")
def test_ms_ssim_of_kornia(benchmark):
    from kornia.losses import MS_SSIMLoss

    loss = MS_SSIMLoss(alpha=1.0, compensation=1.0)  # its own definition: five full-size windows
    benchmark.pedantic(loss, args=pair(192, 192), rounds=3, warmup_rounds=1)
