"""Where training begins: as a blur of the first samples, not as noise."""

from __future__ import annotations

import torch
from torch import Tensor

from methods.ours.network import Networks
from rlbench.ops.initialise import initialise

FAINT = 0.1  # share of a random weight that is left beside a wired one
LINEAR = 0.5  # of a display value: where tanh is nearly a line


@torch.no_grad()
def start(networks: Networks, seed: int) -> None:
    """Seeded weights, a uniform sampler, and a path that shows the first samples, blurred.

    The loss is mostly MS-SSIM, which says little about brightness and colour: from random weights
    these take thousands of steps to be right, and meanwhile the encoder's tanh saturates. So three
    hidden units of the encoder are wired to the colour of the first sample, three channels of the
    state to these, averaged over 3x3, and the denoiser's last three layers to those.
    """
    initialise(networks, seed)
    if networks.sampler is not None:
        networks.sampler.start_uniform()
    encoder, denoiser = networks.encoder, networks.denoiser
    encoder.second.weight.mul_(FAINT)
    skip = denoiser.dec_conv1a.in_channels - encoder.second.out_channels  # the state comes last
    for colour in range(3):
        _wire(encoder.first.weight, colour, colour, 1.0, box=False)
        _wire(encoder.second.weight, colour, colour, LINEAR, box=True)
        _wire(denoiser.dec_conv1a.weight, colour, skip + colour, 1.0, box=True)
        _wire(denoiser.dec_conv1b.weight, colour, colour, 1.0, box=True)
        _wire(denoiser.dec_conv0.weight, colour, colour, 1 / LINEAR, box=False)


def _wire(weight: Tensor, to: int, source: int, gain: float, box: bool) -> None:
    """Make output `to` of a 3x3 convolution its input `source`, or the 3x3 mean of it."""
    weight[to] *= FAINT
    weight[to, source] = gain / 9 if box else 0.0
    if not box:
        weight[to, source, 1, 1] = gain
