"""DASR's two networks: U-Nets of equal shape, one for the sampling map and one for the image."""

from __future__ import annotations

from itertools import pairwise

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.init import kaiming_init
from rlbench.ops.padding import crop, pad
from rlbench.ops.upsample import UpsampleConcatConv

INPUT_CHANNELS = 10  # colour, albedo, normal, depth
ENCODER_WIDTHS = (32, 43, 57, 76, 101)  # of both convolutions of a level, fine to coarse
DECODER_WIDTHS = ((76, 76), (57, 57), (43, 43), (32, 32), (128, 64))  # coarse to fine
STRIDE = 32  # sides are padded to a multiple of this: five poolings
NEGATIVE_SLOPE = 0.1  # of the leaky ReLU
LAST_LAYER_GAIN = 0.1  # of the last layers' initial weights, times He's


class Networks(nn.Module):
    """Sampler and denoiser, trained and stored together."""

    def __init__(self) -> None:
        """Both take 10 channels; the sampler returns one channel, the denoiser three."""
        super().__init__()
        self.sampler = UNet(INPUT_CHANNELS, 1)
        self.denoiser = UNet(INPUT_CHANNELS, 3)

    def init_weights(self, seed: int) -> None:
        """Draw seeded weights; small last layers start the density near uniform."""
        kaiming_init(self, seed)
        for network in (self.sampler, self.denoiser):
            for weight in network.last.parameters():
                weight.data.mul_(LAST_LAYER_GAIN)


class UNet(nn.Module):
    """U-Net with five levels and two 3 x 3 convolutions per level; 1.07 million parameters.

    Kuznetsov et al. 2018, as in training code that was published without their name: leaky ReLU
    with slope 0.1 after every convolution but the last, 2 x 2 max pooling, nearest-neighbour
    upsampling, and skip connections from before the pooling.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        """Layers from `inputs` to `outputs` channels."""
        super().__init__()
        bottom = ENCODER_WIDTHS[-1]
        encoder_inputs = (inputs, *ENCODER_WIDTHS[:-1])
        decoder_inputs = (bottom, *(widths[-1] for widths in DECODER_WIDTHS[:-1]))
        self.encoder = nn.ModuleList(
            _convolutions(before, width, width)
            for before, width in zip(encoder_inputs, ENCODER_WIDTHS, strict=True)
        )
        self.bottom = _convolutions(bottom, bottom, bottom)
        self.decoder = nn.ModuleList(
            _convolutions((before, skip), *widths)
            for before, skip, widths in zip(
                decoder_inputs, reversed(ENCODER_WIDTHS), DECODER_WIDTHS, strict=True
            )
        )
        self.last = nn.Conv2d(DECODER_WIDTHS[-1][-1], outputs, 3, padding=1)

    def forward(self, features: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c2 h w"]:
        """Linear output in float32; any image size, padded inside by repeating the border."""
        h, w = features.shape[-2:]
        features, skips = pad(features, STRIDE), []
        for level in self.encoder:
            skips.append(level(features))
            features = F.max_pool2d(skips[-1], 2)
        features = self.bottom(features)
        for level, skip in zip(self.decoder, reversed(skips), strict=True):
            upsample_concat_conv, *layers = level.children()
            features = upsample_concat_conv(features, skip)
            for layer in layers:
                features = layer(features)
        output: Tensor = self.last(features).float()
        return crop(output, h, w)


def _convolutions(inputs: int | tuple[int, int], *widths: int) -> nn.Sequential:
    """3 x 3 convolutions to each of `widths`, with activations.

    `inputs` is a number of channels, or those of the coarser level and of the skip connection.
    """
    first = (
        UpsampleConcatConv(*inputs, widths[0])
        if isinstance(inputs, tuple)
        else _conv(inputs, widths[0])
    )
    layers: list[nn.Module] = [first, nn.LeakyReLU(NEGATIVE_SLOPE, inplace=True)]
    for width, next_width in pairwise(widths):
        layers += [_conv(width, next_width), nn.LeakyReLU(NEGATIVE_SLOPE, inplace=True)]
    return nn.Sequential(*layers)


def _conv(inputs: int, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1)
