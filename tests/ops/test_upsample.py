"""A rising convolution is that of the doubled level joined with the skip, at less work."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional as F

from rlbench.ops.upsample import UpsampleConcatConv


def joined(layer, coarse, skip):
    """The same by the definition: doubled, joined, convolved."""
    doubled = F.interpolate(coarse, scale_factor=2.0, mode="nearest")
    return F.conv2d(torch.cat((doubled, skip), 1), layer.weight, layer.bias, padding=1)


def inputs(h, w, dtype=torch.float64):
    generator = torch.Generator().manual_seed(7)
    rand = lambda *shape: torch.randn(shape, generator=generator, dtype=dtype)  # noqa: E731
    return rand(2, 5, h, w), rand(2, 3, 2 * h, 2 * w)


@pytest.mark.parametrize("size", [(1, 1), (1, 4), (6, 5)])
@pytest.mark.parametrize("order", [torch.contiguous_format, torch.channels_last])
def test_it_is_the_convolution_of_the_doubled_level_and_the_skip(size, order):
    layer = UpsampleConcatConv(5, 3, 4).double().to(memory_format=order)
    coarse, skip = inputs(*size)
    # sums of 72 products of numbers about 1 in double precision
    torch.testing.assert_close(layer(coarse, skip), joined(layer, coarse, skip), rtol=0, atol=1e-13)


def test_so_are_its_gradients():
    layer, given = UpsampleConcatConv(5, 3, 4).double(), inputs(4, 3)
    found = []
    for run in (layer, lambda *pair: joined(layer, *pair)):
        leaves = [x.clone().requires_grad_() for x in given]
        asked = [*leaves, layer.weight, layer.bias]
        found.append(torch.autograd.grad(run(*leaves).square().sum(), asked))
    torch.testing.assert_close(*found, rtol=1e-12, atol=1e-12)


def test_its_parameters_are_those_of_a_convolution():
    layer, plain = UpsampleConcatConv(5, 3, 4), torch.nn.Conv2d(8, 4, 3, padding=1)
    shapes = [{k: v.shape for k, v in each.state_dict().items()} for each in (layer, plain)]
    assert shapes[0] == shapes[1]


def test_under_autocast_it_computes_in_half_precision():
    layer, (coarse, skip) = UpsampleConcatConv(5, 3, 4), inputs(6, 5, torch.float32)
    with torch.autocast("cpu", torch.bfloat16):
        found = layer(coarse, skip)
    assert found.dtype == torch.bfloat16
    # 8 bits of mantissa of sums about 3
    torch.testing.assert_close(found.float(), joined(layer, coarse, skip), rtol=0, atol=0.05)
