"""The three networks, layer by layer: sampler, state encoder, denoiser."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from methods.ours.variants import Config
from rlbench.ops.unet import UNet

AUX = 7  # normal 3, albedo 3, depth 1


class Sampler(nn.Module):
    """A narrow U-Net from what is known before sampling to one value a pixel, in [-1, 1].

    Scardigli et al. 2023, section 2.3 (first layer: 4 channels); levels and blocks as in the
    authors' release, "big" table, which is the paper's normal size.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...]) -> None:
        """Build with `inputs` channels and a width for each level, finest first."""
        super().__init__()
        pairs = list(zip(widths, widths[1:], strict=False))
        self.tail = nn.Conv2d(inputs, widths[0], 3, padding=1)
        self.down = nn.ModuleList(_block(a, b) for a, b in pairs)
        self.pool = nn.MaxPool2d(2)
        self.up = nn.ModuleList(nn.ConvTranspose2d(b, a, 2, stride=2) for a, b in pairs[:0:-1])
        self.merge = nn.ModuleList(_block(2 * a, a) for a, _ in pairs[:0:-1])
        self.head = nn.Conv2d(widths[1], 2, 3, padding=1)
        self.last = nn.Conv2d(2, 1, 3, padding=1)

    def start_uniform(self) -> None:
        """Forget the last layer, so that every action is zero and the density is constant."""
        nn.init.zeros_(self.last.weight)
        assert self.last.bias is not None
        nn.init.zeros_(self.last.bias)

    def forward(self, known: Float[Tensor, "n c h w"]) -> Float[Tensor, "n 1 h w"]:
        """The mean action; sides must divide by 4."""
        x = self.tail(known)
        skips = []
        for depth, block in enumerate(self.down):
            x = block(self.pool(x) if depth else x)
            skips.append(x)
        for up, merge, skip in zip(self.up, self.merge, skips[-2::-1], strict=True):
            x = merge(torch.cat((up(x), skip), dim=1))
        return torch.tanh(self.last(self.head(x)))


class Encoder(nn.Module):
    """Samples, view and warped state to the new state, bounded by tanh.

    Kernels are 3x3 as in the paper's text, the input has 63 channels as in its memory count and in
    the release: 24 samples, 7 view, 32 state.
    """

    def __init__(self, inputs: int, latent: int) -> None:
        """Build with `inputs` channels in and `latent` out."""
        super().__init__()
        self.first = nn.Conv2d(inputs, 64, 3, padding=1)
        self.second = nn.Conv2d(64, latent, 3, padding=1)

    def forward(self, seen: Float[Tensor, "n c h w"]) -> Float[Tensor, "n s h w"]:
        """The new state, in [-1, 1]."""
        return torch.tanh(self.second(torch.relu(self.first(seen))))


class Networks(nn.Module):
    """All that is trained and saved for one variant."""

    def __init__(self, config: Config) -> None:
        """Build the networks of `config`; weights are whatever torch's default generator gives."""
        super().__init__()
        known = AUX + config.latent
        self.sampler = Sampler(known, config.sampler) if config.sampler else None
        self.encoder = Encoder(3 * config.slots + known, config.latent)
        self.denoiser = UNet(config.latent)


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1),
    )
