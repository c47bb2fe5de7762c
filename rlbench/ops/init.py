"""Seeded initial weights: the same on every machine, whatever torch's global generator says."""

from __future__ import annotations

import torch
from torch import nn


def kaiming_init(network: nn.Module, seed: int = 0) -> None:
    """Draw every convolution and linear layer anew: normal weights for ReLU, zero biases.

    He et al. 2015, section 2.2: variance 2 / fan-in.
    """
    generator = torch.Generator().manual_seed(seed)
    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            fan_in = layer.weight[0].numel()
            if isinstance(layer, nn.ConvTranspose2d):  # weight is [in out k k], stride = kernel
                fan_in = layer.in_channels
            drawn = torch.randn(layer.weight.shape, generator=generator) * (2 / fan_in) ** 0.5
            with torch.no_grad():
                layer.weight.copy_(drawn)
                if layer.bias is not None:
                    layer.bias.zero_()
