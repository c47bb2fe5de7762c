"""UpsampleConcatConv equals upsampling, concatenation and convolution in three steps."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional as F

from rlbench.ops.upsample import UpsampleConcatConv


def three_steps(layer, coarse, skip):
    """The definition: upsample, concatenate, convolve."""
    upsampled = F.interpolate(coarse, scale_factor=2.0, mode="nearest")
    return F.conv2d(torch.cat((upsampled, skip), 1), layer.weight, layer.bias, padding=1)


def inputs(h, w, dtype=torch.float64):
    generator = torch.Generator().manual_seed(7)
    rand = lambda *shape: torch.randn(shape, generator=generator, dtype=dtype)  # noqa: E731
    return rand(2, 5, h, w), rand(2, 3, 2 * h, 2 * w)


@pytest.mark.parametrize("size", [(1, 1), (1, 4), (6, 5)])
@pytest.mark.parametrize("order", [torch.contiguous_format, torch.channels_last])
def test_the_output_equals_that_of_three_steps(size, order):
    layer = UpsampleConcatConv(5, 3, 4).double().to(memory_format=order)
    coarse, skip = inputs(*size)
    # sums of 72 products of numbers about 1 in double precision
    torch.testing.assert_close(
        layer(coarse, skip), three_steps(layer, coarse, skip), rtol=0, atol=1e-13
    )


def test_gradients_equal_those_of_three_steps():
    layer, tensors = UpsampleConcatConv(5, 3, 4).double(), inputs(4, 3)
    gradients = []
    for run in (layer, lambda *pair: three_steps(layer, *pair)):
        leaves = [x.clone().requires_grad_() for x in tensors]
        variables = [*leaves, layer.weight, layer.bias]
        gradients.append(torch.autograd.grad(run(*leaves).square().sum(), variables))
    torch.testing.assert_close(*gradients, rtol=1e-12, atol=1e-12)


def test_the_parameters_are_those_of_a_convolution():
    layer, plain = UpsampleConcatConv(5, 3, 4), torch.nn.Conv2d(8, 4, 3, padding=1)
    shapes = [{k: v.shape for k, v in module.state_dict().items()} for module in (layer, plain)]
    assert shapes[0] == shapes[1]


def test_autocast_computes_in_half_precision():
    layer, (coarse, skip) = UpsampleConcatConv(5, 3, 4), inputs(6, 5, torch.float32)
    with torch.autocast("cpu", torch.bfloat16):
        half = layer(coarse, skip)
    assert half.dtype == torch.bfloat16
    # 8 bits of significand, sums of about 3
    torch.testing.assert_close(half.float(), three_steps(layer, coarse, skip), rtol=0, atol=0.05)


@torch.no_grad()
def test_kept_kernels_follow_the_weights():
    layer, tensors = UpsampleConcatConv(5, 3, 4).double(), inputs(4, 3)
    changes = (
        lambda: None,
        lambda: layer.weight.mul_(2),
        lambda: layer.load_state_dict(UpsampleConcatConv(5, 3, 4).double().state_dict()),
        lambda: setattr(layer, "weight", torch.nn.Parameter(layer.weight + 1)),
    )
    for change in changes:
        change()
        torch.testing.assert_close(layer(*tensors), three_steps(layer, *tensors))
