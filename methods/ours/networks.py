"""The three networks, layer by layer: sampler, state encoder, denoiser."""

from __future__ import annotations

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from methods.ours.variants import SAMPLES, Config
from rlbench.ops.memory_format import to_channels_last
from rlbench.ops.unet import UNet

VIEW = 7  # normal 3, albedo 3, depth 1
DENOISER_INPUTS = 9  # what Intel's network reads: colour 3, albedo 3, normal 3
HISTORY_INPUTS = 9  # of light gathered before: the last image 3, mean 3, spread, weight, likeness 1
SPREAD = 6  # which of these is the spread


class Sampler(nn.Module):
    """A narrow U-Net from what is known before sampling to one value a pixel, in [-1, 1].

    Scardigli et al. 2023, section 2.3 (first layer: 4 channels); levels and blocks as in the
    authors' release, "big" table, which is the paper's normal size.

    Ours is `paced`: the last channel is the logarithm of the budget, and what tanh bounds is first
    multiplied by a power of the budget, whose factor and exponent are learned. A map that pays with
    4 samples a pixel is too bold with half a sample.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...], paced: bool = False) -> None:
        """Build with `inputs` channels and a width for each level, finest first."""
        super().__init__()
        pairs = list(pairwise(widths))
        self.tail = nn.Conv2d(inputs, widths[0], 3, padding=1)
        self.down = nn.ModuleList(_block(a, b) for a, b in pairs)
        self.pool = nn.MaxPool2d(2)
        self.up = nn.ModuleList(nn.ConvTranspose2d(b, a, 2, stride=2) for a, b in pairs[:0:-1])
        self.merge = nn.ModuleList(_block(2 * a, a) for a, _ in pairs[:0:-1])
        self.head = nn.Conv2d(widths[1], 2, 3, padding=1)
        self.last = nn.Conv2d(2, 1, 3, padding=1)
        self.pace = nn.Parameter(torch.zeros(2)) if paced else None  # log of factor, exponent

    def start_uniform(self) -> None:
        """Forget the last layer, so that every action is zero and the density is constant."""
        nn.init.zeros_(self.last.weight)
        assert self.last.bias is not None
        nn.init.zeros_(self.last.bias)

    def forward(self, known: Float[Tensor, "n c h w"]) -> Float[Tensor, "n 1 h w"]:
        """The mean action; sides must divide by two for each level but two."""
        x = self.tail(to_channels_last(known))
        skips = []
        for depth, block in enumerate(self.down):
            x = block(self.pool(x) if depth else x)
            skips.append(x)
        for up, merge, skip in zip(self.up, self.merge, skips[-2::-1], strict=True):
            x = merge(torch.cat((up(x), skip), dim=1))
        raw = self.last(self.head(x))
        if self.pace is not None:
            raw = raw * (self.pace[0] + self.pace[1] * known[:, -1:, :1, :1]).exp()
        return torch.tanh(raw)


class Encoder(nn.Module):
    """Samples, view and what is remembered to the new state, bounded by tanh.

    Kernels are 3x3 as in the paper's text, samples and view enter as in its memory count and in
    the release: 24 samples, 7 view, 32 state.
    """

    def __init__(self, inputs: int, hidden: tuple[int, ...], outputs: int, kernel: int) -> None:
        """Build with `inputs` channels in, some `hidden` ones between, and `outputs` out."""
        super().__init__()
        widths = pairwise((inputs, *hidden, outputs))
        self.layers = nn.ModuleList(nn.Conv2d(a, b, kernel, padding=kernel // 2) for a, b in widths)

    def forward(self, seen: Float[Tensor, "n c h w"]) -> Float[Tensor, "n s h w"]:
        """The new state, in [-1, 1]."""
        seen = to_channels_last(seen)
        for layer in self.layers[:-1]:
            seen = torch.relu_(layer(seen))
        return torch.tanh(self.layers[-1](seen))


class Networks(nn.Module):
    """All that is trained and saved for one variant."""

    def __init__(self, config: Config) -> None:
        """Build the networks of `config`; weights are whatever torch's default generator gives."""
        super().__init__()
        values = SAMPLES[config.samples]
        remembered = {"state": config.latent, "samples": values, "nothing": 0}[config.remembers]
        known = VIEW + remembered + HISTORY_INPUTS * config.gathers
        self.foreseen = known + config.gathers  # the budget too
        self.sampler = None
        if config.sampler:
            self.sampler = Sampler(self.foreseen, config.sampler, paced=config.gathers)
        self.encoder, state = None, VIEW + values
        if config.encoder:
            # one channel more says how far light gathered before is trusted
            outputs = config.latent + config.gathers
            self.encoder = Encoder(known + values, config.encoder, outputs, config.kernel)
            state = config.latent
        shown = 0 if config.light == "none" else DENOISER_INPUTS
        # as for light, so for the last image
        self.denoiser = UNet(shown + state, 3 + config.gathers, config.denoiser)


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.ReLU(inplace=True),
        nn.Conv2d(outputs, outputs, 3, padding=1),
    )
