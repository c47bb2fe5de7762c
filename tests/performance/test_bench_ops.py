"""Speed of operations on hot paths against other libraries: pytest --benchmark-only."""

from __future__ import annotations

from collections.abc import Callable

import kornia
import pytest
import pytorch_msssim
import torch
from torch.nn import functional as F

from rlbench.ops.exposure import autoexposure
from rlbench.ops.losses import ms_ssim
from rlbench.ops.reprojection import reproject, reproject_bicubic
from rlbench.ops.transfer import pu_forward, pu_inverse
from rlbench.ops.unet import UNet
from rlbench.ops.unet_widths import FAST_WIDTHS
from rlbench.ops.upsample import UpsampleConcatConv

Loss = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
KORNIA = kornia.losses.MS_SSIMLoss(alpha=1.0, compensation=1.0, reduction="mean")  # no L1
LOSSES: dict[str, Loss] = {
    "rlbench": lambda x, y: 1 - ms_ssim(x, y).mean(),
    "pytorch_msssim": lambda x, y: 1 - pytorch_msssim.ms_ssim(x, y, data_range=1),
    "kornia": lambda x, y: KORNIA(x, y),
}


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.benchmark(group="MS-SSIM, forward and backward, 1x3x176x176")
def test_ms_ssim(benchmark, name):
    """A size that all three accept; kornia uses five full-size windows instead of scales."""
    generator = torch.Generator().manual_seed(0)
    reference = torch.rand(1, 3, 176, 176, generator=generator)
    image = (reference + 0.1 * torch.randn(reference.shape, generator=generator)).clamp(0, 1)
    image.requires_grad_()

    def step() -> None:
        image.grad = None
        LOSSES[name](image, reference).backward()

    benchmark.pedantic(step, rounds=5, warmup_rounds=1)
    assert image.grad is not None
    assert torch.isfinite(image.grad).all()


@pytest.mark.parametrize("name", ["autoexposure", "pu", "reproject", "reproject_bicubic", "unet"])
@pytest.mark.benchmark(group="ops, 1x3x256x256")
def test_op(benchmark, name):
    image = torch.rand(1, 3, 256, 256, generator=torch.Generator().manual_seed(0))
    motion = (image[:, :2] - 0.5) * 8
    net = UNet(3, widths=FAST_WIDTHS)
    ops: dict[str, Callable[[], torch.Tensor]] = {
        "autoexposure": lambda: autoexposure(image),
        "pu": lambda: pu_inverse(pu_forward(image)),
        "reproject": lambda: reproject(image, motion)[0],
        "reproject_bicubic": lambda: reproject_bicubic(image, motion)[0],
        "unet": lambda: net(image),
    }
    with torch.inference_mode():
        result = benchmark.pedantic(ops[name], rounds=5, warmup_rounds=1)
    assert torch.isfinite(result).all()


@pytest.mark.parametrize("name", ["rlbench", "torch"])
@pytest.mark.benchmark(group="upsample, concatenate, convolve, 64 + 41 -> 64 x192x192")
def test_upsample_concat_conv(benchmark, name):
    """The widest layer of the U-Net in `ours`, against the three steps in torch."""
    generator = torch.Generator().manual_seed(0)
    coarse, skip = (
        torch.randn(1, c, side, side, generator=generator).to(memory_format=torch.channels_last)
        for c, side in ((64, 96), (41, 192))
    )
    layer = (
        UpsampleConcatConv(64, 41, 64).to(memory_format=torch.channels_last).requires_grad_(False)
    )

    def three_steps() -> torch.Tensor:
        upsampled = F.interpolate(coarse, scale_factor=2.0, mode="nearest")
        return F.conv2d(torch.cat((upsampled, skip), 1), layer.weight, layer.bias, padding=1)

    runs: dict[str, Callable[[], torch.Tensor]] = {
        "rlbench": lambda: layer(coarse, skip),
        "torch": three_steps,
    }
    with torch.inference_mode():
        output = benchmark.pedantic(runs[name], rounds=20, warmup_rounds=2)
        torch.testing.assert_close(output, three_steps(), rtol=0, atol=1e-4)  # sums of 945 products
