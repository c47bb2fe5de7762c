"""IMCD's encoder of single samples, its U-Net that predicts affinities, and their filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.affinity import affinity_sum, cross_affinity_sum
from rlbench.ops.asking import may_ask
from rlbench.ops.init import kaiming_init
from rlbench.ops.padding import crop, pad

GBUFFER_CHANNELS = 7  # normal, albedo, depth
COLOUR_CHANNELS = 3
EMBEDDING = 32  # channels of e_t and of its accumulated history
PASSES = 3  # successive spatial filters
FEATURES = 8  # channels of the features whose distance is the affinity
OUTPUTS = PASSES * FEATURES + PASSES + PASSES + 2  # f, a, c, then b and lambda
STRIDE = 16  # sides are padded to a multiple of this: four poolings
NEGATIVE_SLOPE = 0.01  # of LeakyReLU
LAST_LAYER_GAIN = 0.5  # of the last layer's initial weights, times He's
DILATIONS = (1, 2, 4)  # pixels between taps, for each pass
EPS = 1e-10  # added to sums of weights, eq. 6 and 8


class Kernels(NamedTuple):
    """The kernels of one frame; index k runs over the spatial passes."""

    features: Float[Tensor, "n k 8 h w"]  # f^k
    sharpness: Float[Tensor, "n k 1 h w"]  # a_k >= 0
    centre_weight: Float[Tensor, "n k 1 h w"]  # c_k in (0, 1), of the pixel itself
    temporal_sharpness: Float[Tensor, "n 1 h w"]  # b >= 0
    history_weight: Float[Tensor, "n 1 h w"]  # lambda in (0, 1)


class Networks(nn.Module):
    """Sample encoder and U-Net, trained and stored together."""

    def __init__(self) -> None:
        """Weights are torch's defaults; `init_weights` draws seeded ones."""
        super().__init__()
        self.encoder = Encoder()
        self.unet = UNet()

    def init_weights(self, seed: int) -> None:
        """Draw seeded weights; a small last layer starts all affinities high."""
        kaiming_init(self, seed)
        self.unet.last.weight.data.mul_(LAST_LAYER_GAIN)

    def predict_kernels(
        self, embedding: Float[Tensor, "n 32 h w"], history: Float[Tensor, "n 32 h w"]
    ) -> Kernels:
        """The U-Net's output, mapped to the ranges of `Kernels`; any image size, float32."""
        inputs = torch.cat((embedding, history), 1)
        raw = crop(self.unet(pad(inputs, STRIDE)), *embedding.shape[-2:]).float()
        channels = (PASSES * FEATURES, PASSES, PASSES, 1, 1)
        features, sharpness, centre_weight, temporal_sharpness, history_weight = (
            raw.split_with_sizes(channels, 1)
        )
        return Kernels(
            features.view(-1, PASSES, FEATURES, *raw.shape[-2:]),
            sharpness.square().unsqueeze(2),
            centre_weight.sigmoid().unsqueeze(2),
            temporal_sharpness.square(),
            history_weight.sigmoid(),
        )


class Encoder(nn.Module):
    """Three 1 x 1 convolutions on every sample, and the mean over a pixel's samples.

    LeakyReLU follows each, with the slope 0.01 of one reimplementation of Isik et al. 2021.
    """

    traceable = False  # slots without a sample are skipped on a CPU

    def __init__(self) -> None:
        """From 10 to 32 channels; 2,464 parameters."""
        super().__init__()
        self.first = nn.Conv2d(COLOUR_CHANNELS + GBUFFER_CHANNELS, EMBEDDING, 1)
        self.second = nn.Conv2d(EMBEDDING, EMBEDDING, 1)
        self.third = nn.Conv2d(EMBEDDING, EMBEDDING, 1)

    def forward(
        self,
        colours: Float[Tensor, "n s 3 h w"],
        gbuffer: Float[Tensor, "n 7 h w"],
        valid_mask: Bool[Tensor, "n s 1 h w"],
    ) -> Float[Tensor, "n 32 h w"]:
        """The mean embedding e_t, computed slot by slot so that memory does not grow with slots."""
        total = gbuffer.new_zeros(gbuffer.shape[0], EMBEDDING, *gbuffer.shape[2:])
        for colour, valid in zip(colours.unbind(1), valid_mask.unbind(1), strict=True):
            if not may_ask(valid) or valid.any():
                total = total + self.embed(torch.cat((colour, gbuffer), 1)).float() * valid
        return total / valid_mask.sum(1).clamp_min(1)

    def embed(self, sample: Float[Tensor, "n 10 h w"]) -> Float[Tensor, "n 32 h w"]:
        """The embedding of one sample per pixel."""
        for layer in (self.first, self.second, self.third):
            sample = F.leaky_relu(layer(sample), NEGATIVE_SLOPE, inplace=True)
        return sample


class UNet(nn.Module):
    """U-Net with five levels of two 3 x 3 convolutions, 64 to 32 channels; 938,944 parameters.

    Widths and bilinear upsampling are those of a reimplementation of Isik et al. 2021; a second
    one agrees on the widths. Ours: ReLU.
    """

    def __init__(self) -> None:
        """Layers in the order of evaluation."""
        super().__init__()
        self.enc1 = _double_conv(2 * EMBEDDING, 64, 64)  # full resolution
        self.enc2 = _double_conv(64, 64, 64)  # 1/2
        self.enc3 = _double_conv(64, 64, 64)  # 1/4
        self.enc4 = _double_conv(64, 80, 80)  # 1/8
        self.bottom = _double_conv(80, 96, 96)  # 1/16
        self.dec4 = _double_conv(96 + 80, 80, 80)
        self.dec3 = _double_conv(80 + 64, 64, 64)
        self.dec2 = _double_conv(64 + 64, 64, 64)
        self.dec1 = nn.Conv2d(64 + 64, 32, 3, padding=1)
        self.last = nn.Conv2d(32, OUTPUTS, 3, padding=1)

    def forward(self, x: Float[Tensor, "n 64 h w"]) -> Float[Tensor, "n 32 h w"]:
        """Linear output at full resolution; h and w must be multiples of 16."""
        full = self.enc1(x)
        half = self.enc2(F.max_pool2d(full, 2))
        quarter = self.enc3(F.max_pool2d(half, 2))
        eighth = self.enc4(F.max_pool2d(quarter, 2))
        bottom = self.bottom(F.max_pool2d(eighth, 2))

        level = self.dec4(_upsample_concat(bottom, eighth))
        level = self.dec3(_upsample_concat(level, quarter))
        level = self.dec2(_upsample_concat(level, half))
        level = F.relu(self.dec1(_upsample_concat(level, full)), inplace=True)
        raw: Tensor = self.last(level)
        return raw


def _double_conv(inputs: int, middle: int, outputs: int) -> nn.Sequential:
    first = nn.Conv2d(inputs, middle, 3, padding=1)
    second = nn.Conv2d(middle, outputs, 3, padding=1)
    return nn.Sequential(first, nn.ReLU(inplace=True), second, nn.ReLU(inplace=True))


def _upsample_concat(coarse: Tensor, skip: Tensor) -> Tensor:
    upsampled = F.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)
    return torch.cat((upsampled, skip), 1)


@dataclass(frozen=True)
class KernelSizes:
    """Sides of the kernels.

    11 as in one reimplementation of Isik et al. 2021; another has 7, to save memory, which here
    does not grow with the side. The paper's own sizes could not be verified.
    """

    spatial: int = 11  # taps, odd
    temporal: int = 11  # taps, odd


class PreviousFrame(NamedTuple):
    """Features and denoised image of the previous frame, reprojected; finite everywhere."""

    features: Float[Tensor, "n 8 h w"]
    denoised: Float[Tensor, "n 3 h w"]  # demodulated, linear
    weight: Float[Tensor, "n 1 h w"]  # of each pixel, in [0, 1]; 0 without history


def apply_affinity_kernels(
    irradiance: Float[Tensor, "n 3 h w"],
    kernels: Kernels,
    previous: PreviousFrame | None,
    kernel_sizes: KernelSizes,
) -> Float[Tensor, "n 3 h w"]:
    """Irradiance averaged over pixels with similar features: eq. 4, 6, 7 and 8 of Isik et al. 2021.

    Pass k = 0, 1, 2 averages neighbours q of pixel p at dilation 1, 2, 4 with the weights
    exp(-a_k(p) |f^k_p - f^k_q|^2), and p itself with the weight c_k. The last pass adds the
    previous denoised image, undilated and including p, with the weights exp(-b_p |f^2_p - g_q|^2),
    where g are the reprojected features of the previous frame. Sums are divided by the sums of
    weights plus 1e-10.

    Ours: pixels beyond the border have no weight, and those of the previous frame their own times
    that of the kernel.
    """
    ones = torch.ones_like(irradiance[:, :1])
    for k, dilation in enumerate(DILATIONS):
        features, sharpness = kernels.features[:, k], kernels.sharpness[:, k]
        source = torch.cat((irradiance, ones), 1)
        total = kernels.centre_weight[:, k] * source
        total = total + affinity_sum(features, sharpness, source, kernel_sizes.spatial, dilation)
        if previous is not None and k == len(DILATIONS) - 1:
            history = torch.cat((previous.denoised, ones), 1) * previous.weight
            total = total + cross_affinity_sum(
                features,
                kernels.temporal_sharpness,
                previous.features,
                history,
                kernel_sizes.temporal,
            )
        irradiance = total[:, :3] / (total[:, 3:] + EPS)
    return irradiance
