"""The two networks: equal U-Nets, one for the map of samples and one for the image."""

from __future__ import annotations

from itertools import pairwise

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.init import kaiming_init
from rlbench.ops.pad import crop, pad
from rlbench.ops.upsample import UpsampleConcatConv

INPUTS = 10  # colour, albedo, normal, depth
ENCODER = (32, 43, 57, 76, 101)  # channels of both convolutions of a level, fine to coarse
DECODER = ((76, 76), (57, 57), (43, 43), (32, 32), (128, 64))  # coarse to fine
STRIDE = 32  # five poolings
SLOPE = 0.1  # of the leaky ReLU below zero
FAINT = 0.1  # share of He's weights that the last layers start with


class Networks(nn.Module):
    """Sampler and denoiser, trained and stored together."""

    def __init__(self) -> None:
        """10 channels into each; the sampler says one number a pixel, the denoiser a colour."""
        super().__init__()
        self.sampler = UNet(INPUTS, 1)
        self.denoiser = UNet(INPUTS, 3)

    def init_weights(self, seed: int) -> None:
        """Seeded weights, faint in the last layers: the map starts near uniform."""
        kaiming_init(self, seed)
        for network in (self.sampler, self.denoiser):
            for weight in network.last.parameters():
                weight.data.mul_(FAINT)


class UNet(nn.Module):
    """Five levels of two 3x3 convolutions down, two at the bottom, five levels of two up.

    Kuznetsov et al. 2018, as in training code that was published without their name: leaky ReLU of
    slope 0.1 after each convolution but the last, maxima of 2x2 downwards, nearest neighbour
    upwards, and skips of the features before pooling. 1.07 million parameters.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        """Layers for `inputs` channels in and `outputs` out."""
        super().__init__()
        bottom = ENCODER[-1]
        entering = (inputs, *ENCODER[:-1])
        rising = (bottom, *(widths[-1] for widths in DECODER[:-1]))
        self.encoder = nn.ModuleList(
            _convolutions(w, each, each) for w, each in zip(entering, ENCODER, strict=True)
        )
        self.bottom = _convolutions(bottom, bottom, bottom)
        self.decoder = nn.ModuleList(
            _convolutions((w, skip), *widths)
            for w, skip, widths in zip(rising, reversed(ENCODER), DECODER, strict=True)
        )
        self.last = nn.Conv2d(DECODER[-1][-1], outputs, 3, padding=1)

    def forward(self, seen: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c2 h w"]:
        """The outputs, any range, in float32; any size, borders repeated up to a multiple of 32."""
        features, skips = pad(seen, STRIDE), []
        for level in self.encoder:
            skips.append(level(features))
            features = F.max_pool2d(skips[-1], 2)
        features = self.bottom(features)
        for level, skip in zip(self.decoder, reversed(skips), strict=True):
            rise, *others = level.children()
            features = rise(features, skip)
            for layer in others:
                features = layer(features)
        said: Tensor = self.last(features).float()
        return crop(said, *seen.shape[-2:])


def _convolutions(entering: int | tuple[int, int], *widths: int) -> nn.Sequential:
    """3x3 convolutions to each of `widths`, with activations; a level and its skip may enter."""
    first = (
        UpsampleConcatConv(*entering, widths[0])
        if isinstance(entering, tuple)
        else _conv(entering, widths[0])
    )
    layers: list[nn.Module] = [first, nn.LeakyReLU(SLOPE, inplace=True)]
    for width, following in pairwise(widths):
        layers += [_conv(width, following), nn.LeakyReLU(SLOPE, inplace=True)]
    return nn.Sequential(*layers)


def _conv(inputs: int, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1)
