"""The networks of `ours`: their sizes, and the pace of the sampler."""

from __future__ import annotations

import math

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from methods.ours import VARIANTS
from methods.ours.networks import Encoder, Networks, Sampler
from rlbench.ops.init import kaiming_init


def parameters(network: nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


@pytest.mark.parametrize(
    ("network", "count"),
    [
        (Networks(VARIANTS["paper"]).sampler, 31_101),
        (Networks(VARIANTS["paper"]).encoder, 54_816),
        (Networks(VARIANTS["paper"]).denoiser, 939_683),
        (Encoder(63, (64,), 32, 1), 6_176),  # 1x1 kernels, as in the release
        (Sampler(39, VARIANTS["latent-small"].sampler), 486 - 19),  # the release has two outputs
    ],
    ids=["sampler", "encoder", "denoiser", "small encoder", "small sampler"],
)
def test_parameter_counts_are_those_of_the_fact_sheet(network, count):
    assert parameters(network) == count


def test_a_paced_sampler_multiplies_its_action_by_a_power_of_the_budget():
    sampler = Sampler(4, (4, 8, 16), paced=True)
    kaiming_init(sampler, 0)
    sampler.last.weight.data.mul_(0.01)  # where tanh is nearly linear
    inputs = torch.randn(1, 4, 16, 16, generator=torch.Generator().manual_seed(0))
    inputs[:, -1] = math.log(3.0)
    with torch.no_grad():
        plain = sampler(inputs).atanh()
        sampler.pace.copy_(torch.tensor([math.log(0.5), -1.0]))
        torch.testing.assert_close(sampler(inputs).atanh(), plain / 6, rtol=1e-3, atol=1e-4)


def test_a_sampler_with_a_stride_acts_on_means_of_blocks():
    """On an input that is constant in each block, it acts as a sampler of the small image."""
    coarse, fine = (Sampler(4, (4, 8, 16), stride=stride) for stride in (1, 2))
    kaiming_init(coarse, 0)
    coarse.last.weight.data.mul_(0.01)  # where tanh is nearly linear
    fine.load_state_dict(coarse.state_dict())
    small = torch.randn(1, 4, 16, 16, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        action = fine(F.interpolate(small, scale_factor=2, mode="nearest"))
        expected = F.interpolate(coarse(small).atanh(), scale_factor=2, mode="bilinear").tanh()
    torch.testing.assert_close(action, expected, rtol=1e-4, atol=1e-5)
