"""The two networks: one sees every sample by itself, one draws what pixels are compared by."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.init import kaiming_init
from rlbench.ops.pad import crop, pad

VIEW = 7  # normal, albedo, depth
COLOUR = 3
EMBEDDING = 32  # channels of e_t and of its memory
PASSES = 3  # spatial filters, one after the other
FEATURES = 8  # channels that two pixels are compared by
OUTPUTS = PASSES * FEATURES + PASSES + PASSES + 2  # f, a, c, then b and the weight of memory
STRIDE = 16  # four poolings
SLOPE = 0.01  # of LeakyReLU below zero
MILD = 0.5  # share of He's weights that the last layer starts with


class Kernels(NamedTuple):
    """All that the filter of one frame is made from; index k runs over the spatial passes."""

    features: Float[Tensor, "n k 8 h w"]  # f^k
    sharpness: Float[Tensor, "n k 1 h w"]  # a_k >= 0
    centre_weight: Float[Tensor, "n k 1 h w"]  # c_k in (0, 1): weight of the pixel itself
    temporal_sharpness: Float[Tensor, "n 1 h w"]  # b >= 0
    history_weight: Float[Tensor, "n 1 h w"]  # lambda in (0, 1): weight of what is remembered


class Networks(nn.Module):
    """Encoder of samples and U-Net, trained and stored together."""

    def __init__(self) -> None:
        """Weights are torch's own; for seeded ones see `draw`."""
        super().__init__()
        self.encoder = Encoder()
        self.unet = UNet()

    def init_weights(self, seed: int) -> None:
        """Seeded weights; the last layer starts mild, so that neighbours start as alike."""
        kaiming_init(self, seed)
        self.unet.last.weight.data.mul_(MILD)

    def predict_kernels(
        self, embedding: Float[Tensor, "n 32 h w"], memory: Float[Tensor, "n 32 h w"]
    ) -> Kernels:
        """What the U-Net says of this frame, brought into range; any size, float32."""
        seen = torch.cat((embedding, memory), 1)
        raw = crop(self.unet(pad(seen, STRIDE)), *embedding.shape[-2:]).float()
        parts = (PASSES * FEATURES, PASSES, PASSES, 1, 1)
        features, sharpness, centre, past_sharpness, keep = raw.split_with_sizes(parts, 1)
        return Kernels(
            features.view(-1, PASSES, FEATURES, *raw.shape[-2:]),
            sharpness.square().unsqueeze(2),
            centre.sigmoid().unsqueeze(2),
            past_sharpness.square(),
            keep.sigmoid(),
        )


class Encoder(nn.Module):
    """Three 1x1 convolutions on each sample, and the mean over those that were bought.

    Each is followed by LeakyReLU, of slope 0.01 as one reimplementation of Isik et al. 2021 has it.
    """

    def __init__(self) -> None:
        """10 channels in, 32 out; 2,464 parameters."""
        super().__init__()
        self.first = nn.Conv2d(COLOUR + VIEW, EMBEDDING, 1)
        self.second = nn.Conv2d(EMBEDDING, EMBEDDING, 1)
        self.third = nn.Conv2d(EMBEDDING, EMBEDDING, 1)

    def forward(
        self,
        colours: Float[Tensor, "n s 3 h w"],
        gbuffer: Float[Tensor, "n 7 h w"],
        filled: Bool[Tensor, "n s 1 h w"],
    ) -> Float[Tensor, "n 32 h w"]:
        """The mean embedding e_t; slot by slot, so that memory does not grow with slots."""
        total = gbuffer.new_zeros(gbuffer.shape[0], EMBEDDING, *gbuffer.shape[2:])
        for colour, bought in zip(colours.unbind(1), filled.unbind(1), strict=True):
            if bought.any():
                total = total + self.embed(torch.cat((colour, gbuffer), 1)).float() * bought
        return total / filled.sum(1).clamp_min(1)

    def embed(self, sample: Float[Tensor, "n 10 h w"]) -> Float[Tensor, "n 32 h w"]:
        """One sample of each pixel by itself."""
        for layer in (self.first, self.second, self.third):
            sample = F.leaky_relu(layer(sample), SLOPE, inplace=True)
        return sample


class UNet(nn.Module):
    """Five levels of pairs of 3x3 convolutions, 64 channels in and 32 out; 938,944 parameters.

    Widths, and bilinear steps up, are those of a reimplementation of Isik et al. 2021; a second
    agrees on the widths. Ours: ReLU.
    """

    def __init__(self) -> None:
        """The layers, in the order in which they are gone through."""
        super().__init__()
        self.enc1 = _pair(2 * EMBEDDING, 64, 64)  # full resolution
        self.enc2 = _pair(64, 64, 64)  # 1/2
        self.enc3 = _pair(64, 64, 64)  # 1/4
        self.enc4 = _pair(64, 80, 80)  # 1/8
        self.bottom = _pair(80, 96, 96)  # 1/16
        self.dec4 = _pair(96 + 80, 80, 80)
        self.dec3 = _pair(80 + 64, 64, 64)
        self.dec2 = _pair(64 + 64, 64, 64)
        self.dec1 = nn.Conv2d(64 + 64, 32, 3, padding=1)
        self.last = nn.Conv2d(32, OUTPUTS, 3, padding=1)

    def forward(self, x: Float[Tensor, "n 64 h w"]) -> Float[Tensor, "n 32 h w"]:
        """Linear outputs at full resolution; h and w divide by 16."""
        full = self.enc1(x)
        half = self.enc2(F.max_pool2d(full, 2))
        quarter = self.enc3(F.max_pool2d(half, 2))
        eighth = self.enc4(F.max_pool2d(quarter, 2))
        bottom = self.bottom(F.max_pool2d(eighth, 2))

        level = self.dec4(_join(bottom, eighth))
        level = self.dec3(_join(level, quarter))
        level = self.dec2(_join(level, half))
        level = F.relu(self.dec1(_join(level, full)), inplace=True)
        raw: Tensor = self.last(level)
        return raw


def _pair(inputs: int, middle: int, outputs: int) -> nn.Sequential:
    first = nn.Conv2d(inputs, middle, 3, padding=1)
    second = nn.Conv2d(middle, outputs, 3, padding=1)
    return nn.Sequential(first, nn.ReLU(inplace=True), second, nn.ReLU(inplace=True))


def _join(coarse: Tensor, skip: Tensor) -> Tensor:
    raised = F.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)
    return torch.cat((raised, skip), 1)
