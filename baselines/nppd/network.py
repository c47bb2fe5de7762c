"""NPPD's encoder of single samples, its U-Net that predicts weights, and the filter of these."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from baselines.imcd.network import EMBEDDING
from baselines.imcd.network import Encoder as SampleEncoder
from rlbench.ops.init import kaiming_init
from rlbench.ops.kernels import splat_kernels
from rlbench.ops.memory_format import to_channels_last, to_contiguous_float32
from rlbench.ops.upsample import UpsampleConcatConv

Widths = tuple[tuple[int, ...], ...]  # channels of the convolutions of each level, fine to coarse

LEVELS = 5  # K of the paper: full resolution to 1/16
DENOISING_TAPS = 25  # 5 x 5, from a pixel to pixels of its level
UPSAMPLING_TAPS = 16  # 4 x 4, from a pixel to pixels of the next finer level
COLOUR_CHANNELS = 3
INPUTS = 2 * (COLOUR_CHANNELS + EMBEDDING)  # of the U-Net: history and current frame
STRIDE = 32  # sides are padded to a multiple of this: five poolings
NEGATIVE_SLOPE = 0.3  # of LeakyReLU
HEAD_GAIN = 0.1  # of the initial weights of the last layers, times He's
FINEST_OUTPUTS = (DENOISING_TAPS, DENOISING_TAPS, 1, 1, LEVELS)
COARSE_OUTPUTS = (DENOISING_TAPS, UPSAMPLING_TAPS)

# the "15M" network that its authors run at 2 and 4 spp
LARGE_WIDTHS: Widths = (
    (96, 96), (96, 128), (128, 192), (192, 256), (256, 384), (512, 512, 384),
)  # fmt: skip
# half of it on the two finest levels, where the time is spent; fewer below, where the weights are
WIDTHS: Widths = ((48, 48), (48, 64), (64, 80), (80, 96), (96, 112), (128, 128, 112))


class FilterWeights(NamedTuple):
    """The weights of one frame, all >= 0; level i has 1 / 2^i of the resolution."""

    partition: Float[Tensor, "n levels h w"]  # share of each level in a pixel's light, sum 1
    kernels: tuple[Float[Tensor, "n 25 _ _"], ...]  # for each level, sum 1
    upsampling: tuple[Float[Tensor, "n 16 _ _"], ...]  # of levels 1 to 4, sum 4
    history_kernels: Float[Tensor, "n 25 h w"]  # for the previous image, sum 1
    output_history_weight: Float[Tensor, "n 1 h w"]  # mu in (0, 1), of the previous image
    input_history_weight: Float[Tensor, "n 1 h w"]  # lambda in (0, 1), of light and features


class Networks(nn.Module):
    """Sample encoder and U-Net, trained and stored together."""

    def __init__(self, widths: Widths = WIDTHS) -> None:
        """Weights are torch's defaults; `init_weights` draws seeded ones."""
        super().__init__()
        self.encoder = Encoder()
        self.unet = WeightUNet(widths)

    def init_weights(self, seed: int) -> None:
        """Draw seeded weights; small last layers start kernels and partition near uniform."""
        kaiming_init(self, seed)
        for weight in self.unet.heads.parameters():
            weight.data.mul_(HEAD_GAIN)

    def predict_weights(self, inputs: Float[Tensor, "n 70 h w"]) -> FilterWeights:
        """The U-Net's outputs, mapped to weights in float32; h and w must be multiples of 32."""
        finest, *coarse = (to_contiguous_float32(output) for output in self.unet(inputs))
        kernels, history_kernels, mu, lambda_, partition = finest.split_with_sizes(
            FINEST_OUTPUTS, 1
        )
        pairs = [output.split_with_sizes(COARSE_OUTPUTS, 1) for output in coarse]
        return FilterWeights(
            partition.softmax(1),
            (kernels.softmax(1), *(logits.softmax(1) for logits, _ in pairs)),
            tuple(4 * logits.softmax(1) for _, logits in pairs),  # a pixel becomes 2 x 2
            history_kernels.softmax(1),
            mu.sigmoid(),
            lambda_.sigmoid(),
        )


class Encoder(SampleEncoder):
    """Three 1 x 1 convolutions on every sample, and the mean over a pixel's samples.

    LeakyReLU follows the first two. The last is linear, so it is applied once, to the mean.
    2,464 parameters.
    """

    def forward(
        self,
        colours: Float[Tensor, "n s 3 h w"],
        gbuffer: Float[Tensor, "n 7 h w"],
        valid_mask: Bool[Tensor, "n s 1 h w"],
    ) -> Float[Tensor, "n 32 h w"]:
        """The mean embedding in float32; every pixel needs a sample."""
        mean: Tensor = self.third(super().forward(colours, gbuffer, valid_mask))
        return mean.float()

    def embed(self, sample: Float[Tensor, "n 10 h w"]) -> Float[Tensor, "n 32 h w"]:
        """Features of one sample per pixel before the last layer."""
        for layer in (self.first, self.second):
            sample = F.leaky_relu(layer(sample), NEGATIVE_SLOPE, inplace=True)
        return sample


class WeightUNet(nn.Module):
    """U-Net of 3 x 3 convolutions with LeakyReLU, and a 1 x 1 output at each filtered level.

    Levels are joined by max pooling, nearest-neighbour upsampling and concatenated skips. The last
    level is the bottleneck and has no output. The decoder of a level runs through its widths in
    reverse. 15.6 M parameters with `LARGE_WIDTHS`, 1.8 M with `WIDTHS`.
    """

    def __init__(self, widths: Widths) -> None:
        """Create all layers; `widths` has one entry more than there are filtered levels."""
        super().__init__()
        inputs = (INPUTS, *(level[-1] for level in widths))
        self.encoders = nn.ModuleList(map(_convolutions, inputs, widths))
        coarser = (*(level[0] for level in widths[1:-1]), widths[-1][-1])
        self.decoders = nn.ModuleList(map(DecoderLevel, coarser, widths[:-1]))
        outputs = [sum(FINEST_OUTPUTS)] + [sum(COARSE_OUTPUTS)] * (LEVELS - 1)
        self.heads = nn.ModuleList(
            nn.Conv2d(level[0], count, 1) for level, count in zip(widths[:-1], outputs, strict=True)
        )

    def forward(self, x: Float[Tensor, "n 70 h w"]) -> list[Float[Tensor, "n _ _ _"]]:
        """Outputs of the levels, fine to coarse: 57 channels, then 41 each."""
        x, skips = self.encoders[0](to_channels_last(x)), []
        for encoder in self.encoders[1:]:
            skips.append(x)
            x = encoder(F.max_pool2d(x, 2))
        outputs = []
        for decoder, head in zip(reversed(self.decoders), reversed(self.heads), strict=True):
            x = decoder(x, skips.pop())
            outputs.append(head(x))
        return outputs[::-1]


class DecoderLevel(nn.Module):
    """Joins a coarser level with the skip, then runs through the widths of a level in reverse."""

    def __init__(self, coarse_channels: int, widths: tuple[int, ...]) -> None:
        """`widths` are those of the encoder at the same level."""
        super().__init__()
        self.join = UpsampleConcatConv(coarse_channels, widths[-1], widths[-1])
        self.rest = _convolutions(widths[-1], widths[-2::-1])

    def forward(
        self, coarse: Float[Tensor, "n c h w"], skip: Float[Tensor, "n c2 2*h 2*w"]
    ) -> Float[Tensor, "n c3 2*h 2*w"]:
        """Features at the resolution of the skip."""
        features: Tensor = self.rest(F.leaky_relu_(self.join(coarse, skip), NEGATIVE_SLOPE))
        return features


def _convolutions(channels: int, widths: tuple[int, ...]) -> nn.Sequential:
    """3 x 3 convolutions in a row, from `channels` on, each followed by LeakyReLU."""
    layers: list[nn.Module] = []
    for width in widths:
        layers += [nn.Conv2d(channels, width, 3, padding=1)]
        layers += [nn.LeakyReLU(NEGATIVE_SLOPE, inplace=True)]
        channels = width
    return nn.Sequential(*layers)


def apply_partitioning_pyramid(
    irradiance: Float[Tensor, "n 3 h w"], previous: Float[Tensor, "n 3 h w"], weights: FilterWeights
) -> Float[Tensor, "n 3 h w"]:
    """Irradiance split over levels and splatted, blended with the splatted previous image.

    Level i holds the irradiance times its partition weight, averaged over 2^i x 2^i pixels. Every
    pixel of a level spreads its light by its own 5 x 5 kernel. From the coarsest level on, the sum
    is spread to 2 x 2 pixels per pixel by 4 x 4 kernels, and the next finer level is added. The
    result has the weight 1 - mu; the previous image, spread by 5 x 5 kernels, has mu.

    h and w must be multiples of 16. Light is neither lost nor created, except by mu.
    """
    levels = [
        splat_kernels(kernels, _average(irradiance * weights.partition[:, i : i + 1], 2**i))
        for i, kernels in enumerate(weights.kernels)
    ]
    denoised = levels.pop()
    for level, kernels in zip(reversed(levels), reversed(weights.upsampling), strict=True):
        denoised = level + splat_kernels(kernels, denoised, stride=2)
    history = splat_kernels(weights.history_kernels, previous)
    return torch.lerp(denoised, history, weights.output_history_weight)


def _average(image: Tensor, side: int) -> Tensor:
    """The image averaged over tiles of side x side pixels."""
    return F.avg_pool2d(image, side) if side > 1 else image
