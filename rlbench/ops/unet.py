"""The U-Net of Open Image Denoise: what most networks here are built from, layer by layer."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from rlbench.ops.init import kaiming_init
from rlbench.ops.memory_format import to_channels_last
from rlbench.ops.upsample import UpsampleConcatConv

STRIDE = 16  # four poolings: both sides of the input divide by this


class Widths(NamedTuple):
    """Channels of each convolution; a decoder level has two, `a` and `b`."""

    enc1: int  # enc_conv0 and enc_conv1, full resolution
    enc2: int  # 1/2
    enc3: int  # 1/4
    enc4: int  # 1/8
    enc5: int  # enc_conv5a and enc_conv5b, 1/16
    dec4: tuple[int, int]  # 1/8
    dec3: tuple[int, int]  # 1/4
    dec2: tuple[int, int]  # 1/2
    dec1: tuple[int, int]  # full resolution


BASE = Widths(32, 48, 64, 80, 96, (112, 112), (96, 96), (64, 64), (64, 32))  # OIDN "balanced"
FAST = Widths(32, 32, 32, 32, 32, (64, 64), (64, 64), (64, 32), (32, 32))  # OIDN "fast"
SMALL = Widths(32, 24, 32, 40, 48, (56, 56), (48, 48), (32, 32), (32, 16))  # BASE / 2, but enc1


class UNet(nn.Module):
    """Five levels of 3x3 convolutions with ReLU, joined by skips; the last has no ReLU.

    Afra 2019, Open Image Denoise, the network of its training toolkit, with the names of its
    parameters, so that files of either can be laid side by side. Skips carry the *pooled* features
    of a level, and the top skip is the raw input. Weights start as He et al. 2015 have it for ReLU,
    drawn from `seed`, biases at zero.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int = 3,
        widths: Widths = BASE,
        seed: int = 0,
    ) -> None:
        """Layers for `inputs` channels in and `outputs` out."""
        super().__init__()
        e1, e2, e3, e4, e5, (d4a, d4b), (d3a, d3b), (d2a, d2b), (d1a, d1b) = widths
        self.widths = widths
        self.enc_conv0 = _conv(inputs, e1)
        self.enc_conv1 = _conv(e1, e1)
        self.enc_conv2 = _conv(e1, e2)
        self.enc_conv3 = _conv(e2, e3)
        self.enc_conv4 = _conv(e3, e4)
        self.enc_conv5a = _conv(e4, e5)
        self.enc_conv5b = _conv(e5, e5)
        self.dec_conv4a = _rise(e5, e3, d4a)
        self.dec_conv4b = _conv(d4a, d4b)
        self.dec_conv3a = _rise(d4b, e2, d3a)
        self.dec_conv3b = _conv(d3a, d3b)
        self.dec_conv2a = _rise(d3b, e1, d2a)
        self.dec_conv2b = _conv(d2a, d2b)
        self.dec_conv1a = _rise(d2b, inputs, d1a)
        self.dec_conv1b = _conv(d1a, d1b)
        self.dec_conv0 = _conv(d1b, outputs)
        kaiming_init(self, seed)

    def forward(self, x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c2 h w"]:
        """The outputs at full resolution; h and w divide by 16."""
        result: Tensor = self.dec_conv0(self.decode(x)[-1])
        return result

    def decode(self, x: Float[Tensor, "n c h w"]) -> list[Float[Tensor, "n _ _ _"]]:
        """Decoder features at 1/8, 1/4, 1/2 and full resolution: where heads can be attached.

        Their channels are `widths.dec4[1]`, `dec3[1]`, `dec2[1]` and `dec1[1]`.
        """
        x = to_channels_last(x)
        half = _halved(self.enc_conv1(F.relu_(self.enc_conv0(x))))
        quarter = _halved(self.enc_conv2(half))
        eighth = _halved(self.enc_conv3(quarter))
        bottom = _halved(self.enc_conv4(eighth))
        bottom = F.relu_(self.enc_conv5b(F.relu_(self.enc_conv5a(bottom))))

        level4 = F.relu_(self.dec_conv4b(F.relu_(self.dec_conv4a(bottom, eighth))))
        level3 = F.relu_(self.dec_conv3b(F.relu_(self.dec_conv3a(level4, quarter))))
        level2 = F.relu_(self.dec_conv2b(F.relu_(self.dec_conv2a(level3, half))))
        level1 = F.relu_(self.dec_conv1b(F.relu_(self.dec_conv1a(level2, x))))
        return [level4, level3, level2, level1]


def _conv(inputs: int, outputs: int) -> nn.Conv2d:
    # born on meta, so that torch's own initialisation does not draw from the global generator
    born = nn.Conv2d(inputs, outputs, 3, padding=1, device="meta")
    return born.to_empty(device=torch.get_default_device())


def _rise(coarse: int, skip: int, outputs: int) -> UpsampleConcatConv:
    return UpsampleConcatConv(coarse, skip, outputs, device="meta").to_empty(
        device=torch.get_default_device()
    )


def _halved(x: Tensor) -> Tensor:
    """ReLU and the maximum of 2x2, in the order that has less to write."""
    return F.relu_(F.max_pool2d(x, 2))
