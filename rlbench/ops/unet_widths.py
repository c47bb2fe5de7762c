"""Sizes of Open Image Denoise's U-Net, readable without torch."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["BASE_WIDTHS", "FAST_WIDTHS", "UNetWidths"]


class UNetWidths(NamedTuple):
    """Output channels of each convolution; a decoder level has two convolutions, `a` and `b`."""

    enc1: int  # enc_conv0 and enc_conv1, full resolution
    enc2: int  # 1/2
    enc3: int  # 1/4
    enc4: int  # 1/8
    enc5: int  # enc_conv5a and enc_conv5b, 1/16
    dec4: tuple[int, int]  # 1/8
    dec3: tuple[int, int]  # 1/4
    dec2: tuple[int, int]  # 1/2
    dec1: tuple[int, int]  # full resolution


BASE_WIDTHS = UNetWidths(
    32, 48, 64, 80, 96, (112, 112), (96, 96), (64, 64), (64, 32)
)  # OIDN "balanced"
FAST_WIDTHS = UNetWidths(32, 32, 32, 32, 32, (64, 64), (64, 64), (64, 32), (32, 32))  # OIDN "fast"
