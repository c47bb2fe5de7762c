"""Box filters equal torch's average pooling, and pass gradients."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional as F

from rlbench.ops.box_filter import block_mean, box_mean

SIZES = [(1, 1, 9, 17), (2, 3, 16, 24)]


def image(size: tuple[int, ...]) -> torch.Tensor:
    return torch.rand(size, generator=torch.Generator().manual_seed(0), requires_grad=True)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("side", [1, 3, 7, 13])
@pytest.mark.parametrize("mode", ["replicate", "constant"])
def test_box_mean_equals_average_pooling_of_the_padded_image(size, side, mode):
    """To rounding: sums of up to 169 values of at most 1, in another order."""
    ours, torchs = image(size), image(size)
    result = box_mean(ours, side, mode)
    expected = F.avg_pool2d(F.pad(torchs, (side // 2,) * 4, mode=mode), side, 1)
    torch.testing.assert_close(result, expected, rtol=2e-6, atol=1e-7)
    (result**2).sum().backward()
    (expected**2).sum().backward()
    torch.testing.assert_close(ours.grad, torchs.grad, rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("side", [1, 2, 4])
def test_block_mean_equals_average_pooling(side):
    """To rounding, as above."""
    ours, torchs = image((2, 3, 16, 24)), image((2, 3, 16, 24))
    result, expected = block_mean(ours, side), F.avg_pool2d(torchs, side)
    torch.testing.assert_close(result, expected, rtol=2e-6, atol=1e-7)
    (result**2).sum().backward()
    (expected**2).sum().backward()
    torch.testing.assert_close(ours.grad, torchs.grad, rtol=2e-6, atol=1e-7)


def test_the_argument_is_not_changed():
    """Also for a window of one pixel, which is the image itself."""
    before = image((1, 1, 4, 4)).detach()
    for filtered in (box_mean(before, 1), block_mean(before, 1)):
        filtered.zero_()
    torch.testing.assert_close(before, image((1, 1, 4, 4)).detach())
