"""The U-Net of Open Image Denoise, the building block of most networks here."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.init import kaiming_init
from rlbench.ops.memory_format import to_channels_last
from rlbench.ops.unet_widths import BASE_WIDTHS, UNetWidths
from rlbench.ops.upsample import UpsampleConcatConv

__all__ = ["STRIDE", "FeatureUNet", "UNet"]

STRIDE = 16  # both sides of the input must be multiples of this: four poolings


class UNet(nn.Module):
    """Five levels of 3 x 3 convolutions with ReLU and skip connections; the last has no ReLU.

    Afra 2019, Open Image Denoise: the network of its training toolkit, with its parameter names, so
    that weights are interchangeable. Skips carry the *pooled* features of a level; the top skip is
    the raw input. Weights are drawn from `seed` (`kaiming_init`), biases are zero.

    >>> network = UNet(in_channels=9)  # radiance, albedo, normal
    >>> network(torch.zeros(1, 9, 32, 48)).shape
    torch.Size([1, 3, 32, 48])
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int = 3,
        widths: UNetWidths = BASE_WIDTHS,
        seed: int = 0,
    ) -> None:
        """Create all layers; `widths` gives the channels between input and output."""
        super().__init__()
        e1, e2, e3, e4, e5, (d4a, d4b), (d3a, d3b), (d2a, d2b), (d1a, d1b) = widths
        self.widths = widths
        self.enc_conv0 = _conv(in_channels, e1)
        self.enc_conv1 = _conv(e1, e1)
        self.enc_conv2 = _conv(e1, e2)
        self.enc_conv3 = _conv(e2, e3)
        self.enc_conv4 = _conv(e3, e4)
        self.enc_conv5a = _conv(e4, e5)
        self.enc_conv5b = _conv(e5, e5)
        self.dec_conv4a = _upsample_conv(e5, e3, d4a)
        self.dec_conv4b = _conv(d4a, d4b)
        self.dec_conv3a = _upsample_conv(d4b, e2, d3a)
        self.dec_conv3b = _conv(d3a, d3b)
        self.dec_conv2a = _upsample_conv(d3b, e1, d2a)
        self.dec_conv2b = _conv(d2a, d2b)
        self.dec_conv1a = _upsample_conv(d2b, in_channels, d1a)
        self.dec_conv1b = _conv(d1a, d1b)
        self.dec_conv0 = _conv(d1b, out_channels)
        kaiming_init(self, seed)

    def forward(self, x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c2 h w"]:
        """The output at full resolution; h and w must be multiples of 16."""
        result: Tensor = self.dec_conv0(self.decoder_features(x)[-1])
        return result

    def decoder_features(self, x: Float[Tensor, "n c h w"]) -> list[Float[Tensor, "n _ _ _"]]:
        """Decoder features at 1/8, 1/4, 1/2 and full resolution, for custom output heads.

        Their channel counts are `widths.dec4[1]`, `dec3[1]`, `dec2[1]` and `dec1[1]`.
        """
        x = to_channels_last(x)
        half = _relu_pool(self.enc_conv1(F.relu_(self.enc_conv0(x))))
        quarter = _relu_pool(self.enc_conv2(half))
        eighth = _relu_pool(self.enc_conv3(quarter))
        bottom = _relu_pool(self.enc_conv4(eighth))
        bottom = F.relu_(self.enc_conv5b(F.relu_(self.enc_conv5a(bottom))))

        level4 = F.relu_(self.dec_conv4b(F.relu_(self.dec_conv4a(bottom, eighth))))
        level3 = F.relu_(self.dec_conv3b(F.relu_(self.dec_conv3a(level4, quarter))))
        level2 = F.relu_(self.dec_conv2b(F.relu_(self.dec_conv2a(level3, half))))
        level1 = F.relu_(self.dec_conv1b(F.relu_(self.dec_conv1a(level2, x))))
        return [level4, level3, level2, level1]


class FeatureUNet(UNet):
    """The same network, called for the features of its decoder; `dec_conv0` is the caller's."""

    def forward(  # type: ignore[override]
        self, x: Float[Tensor, "n c h w"]
    ) -> list[Float[Tensor, "n _ _ _"]]:
        """`decoder_features`."""
        return self.decoder_features(x)


def _conv(in_channels: int, out_channels: int) -> nn.Conv2d:
    # created on meta, so that torch's own initialization does not use the global generator
    layer = nn.Conv2d(in_channels, out_channels, 3, padding=1, device="meta")
    return layer.to_empty(device=torch.get_default_device())


def _upsample_conv(
    coarse_channels: int, skip_channels: int, out_channels: int
) -> UpsampleConcatConv:
    layer = UpsampleConcatConv(coarse_channels, skip_channels, out_channels, device="meta")
    return layer.to_empty(device=torch.get_default_device())


def _relu_pool(x: Tensor) -> Tensor:
    """ReLU and 2 x 2 max pooling; pooling first writes fewer values, with the same result."""
    return F.relu_(F.max_pool2d(x, 2))
