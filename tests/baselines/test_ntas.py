"""NTAS: limits of its outputs, invalid history, and the gradient at the start."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from baselines.ntas.method import Ntas, build
from baselines.ntas.network import Networks
from baselines.ntas.train import training_task
from rlbench.frames import Size
from tests.baselines.noise import noisy_clip, random_tensor

CPU = torch.device("cpu")


def networks_with_noise(variant: str, network: str) -> Networks:
    """Networks with a random last layer, far from its start."""
    networks = build(variant, CPU, "random").networks
    last = networks.get_submodule(network).unet.dec_conv0.weight
    nn.init.normal_(last, 0, 1e3, torch.Generator().manual_seed(0))
    return networks


def test_extreme_sampler_outputs_still_give_every_pixel_some_density() -> None:
    frame = next(iter(noisy_clip()))
    steep = Ntas(networks_with_noise("", "sampler"))
    density = steep.plan(frame.gbuffer, frame.pool.empty(), steep.start(frame.pool.size))
    assert density.min() > 0


def test_pixels_with_only_invalid_taps_ignore_the_history() -> None:
    denoiser = build("", CPU, "random").networks.denoiser
    features, irradiance = random_tensor(1, 13, 16, 16), random_tensor(1, 3, 16, 16, seed=1)
    valid = (torch.arange(16) >= 8).expand(1, 1, 16, 16)
    dark, bright = (
        denoiser(features, irradiance, torch.full((1, 3, 16, 16), light), valid)
        for light in (0.0, 1e3)
    )
    assert torch.equal(dark[..., :6], bright[..., :6])  # 5x5 taps reach two pixels
    assert (bright[..., 6:] > dark[..., 6:]).all()


def test_the_output_of_direct_is_between_zero_and_the_largest_half() -> None:
    networks = networks_with_noise("direct", "denoiser")
    light = random_tensor(1, 3, 16, 16)
    valid = torch.ones(1, 1, 16, 16, dtype=torch.bool)
    irradiance = networks.denoiser(random_tensor(1, 13, 16, 16), light, light, valid)
    assert irradiance.min() == 0
    assert float(irradiance.max()) == pytest.approx(65504, rel=1e-4)  # exp of 15 in float32


def test_every_colour_of_direct_has_a_gradient_at_the_start() -> None:
    task = training_task("direct", CPU, seed=0)
    next(task.losses(noisy_clip(2, Size(2, 32, 32)), 2.0)).backward()
    assert (task.networks.denoiser.unet.dec_conv0.bias.grad != 0).all()
