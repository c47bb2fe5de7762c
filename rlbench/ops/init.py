"""Seeded weight initialization, independent of torch's global generator."""

from __future__ import annotations

import torch
from torch import nn

__all__ = ["kaiming_init"]


def kaiming_init(network: nn.Module, seed: int = 0) -> None:
    """Initialize all convolutions and linear layers in place: normal weights for ReLU, zero biases.

    The variance is 2 / fan-in (He et al. 2015, section 2.2). The weights depend on `seed` alone and
    are the same on every machine.

    >>> layer = nn.Linear(4, 2)
    >>> kaiming_init(layer, seed=1)
    >>> layer.bias.tolist()
    [0.0, 0.0]
    """
    generator = torch.Generator().manual_seed(seed)
    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            fan_in = layer.weight[0].numel()
            if isinstance(layer, nn.ConvTranspose2d):  # weight is [in out k k], stride = kernel
                fan_in = layer.in_channels
            weight = torch.randn(layer.weight.shape, generator=generator) * (2 / fan_in) ** 0.5
            with torch.no_grad():
                layer.weight.copy_(weight)
                if layer.bias is not None:
                    layer.bias.zero_()
