"""Straightforward versions of the wavelets of SVGF and EAW: whole images, tap by tap."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

B3 = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)
LUMINANCE = (0.2126, 0.7152, 0.0722)
MARGIN = 32  # pixels: two steps of the widest pass


def svgf_passes(
    light: Tensor, variance: Tensor, normal: Tensor, depth: Tensor, slope: Tensor, passes: int = 5
) -> Tensor:
    """Irradiance after `passes` passes; `slope` is the change of depth from pixel to pixel."""
    weights_rgb = torch.tensor(LUMINANCE).view(1, 3, 1, 1)
    gauss = torch.tensor([[1.0, 2, 1], [2, 4, 2], [1, 2, 1]]).view(1, 1, 3, 3) / 16
    for index in range(passes):
        sigma = 4 * (F.conv2d(variance, gauss, padding=1) + 1e-10).sqrt()
        bright = (light * weights_rgb).sum(1, keepdim=True)
        total, spread, weights = (torch.zeros_like(image) for image in (light, variance, sigma))
        stacked = torch.cat((light, variance, bright, depth, normal), 1)
        for y, x, kernel, neighbour in _taps(stacked, 2**index):
            distance = max((y * y + x * x) ** 0.5, 1e-3)
            w_z = torch.exp(-(neighbour[:, 5:6] - depth).abs() / (slope * distance))
            w_n = (neighbour[:, 6:] * normal).sum(1, keepdim=True).clamp_min(0).pow(128)
            w_l = torch.exp(-(neighbour[:, 4:5] - bright).abs() / sigma)
            weight = kernel * w_z * w_n * w_l
            total += weight * neighbour[:, :3]
            spread += weight.square() * neighbour[:, 3:4]
            weights += weight
        light, variance = total / weights, spread / weights.square()
    return light


def eaw_passes(
    light: Tensor, normal: Tensor, depth: Tensor, widths: tuple[float, float, float]
) -> Tensor:
    """Irradiance after five passes; `widths` of the first: for light, normal and depth."""
    for index in range(5):
        light = eaw_pass(light, normal, depth, 2**index, widths)
    return light


def eaw_pass(
    light: Tensor, normal: Tensor, depth: Tensor, step: int, widths: tuple[float, float, float]
) -> Tensor:
    """One pass with `step` pixels between taps."""
    guides = (light.log1p(), normal, depth.log())
    total, weights = torch.zeros_like(light), torch.zeros_like(depth)
    for _, _, kernel, neighbour in _taps(torch.cat((light, *guides), 1), step):
        parts = zip(neighbour[:, 3:].split((3, 3, 1), 1), guides, strict=True)
        by_light, by_normal, by_depth = ((a - b).square().sum(1, keepdim=True) for a, b in parts)
        weight = kernel * torch.exp(-by_light * step / widths[0])
        weight = (
            weight * torch.exp(-by_normal / step**2 / widths[1]) * torch.exp(-by_depth / widths[2])
        )
        total += weight * neighbour[:, :3]
        weights += weight
    return total / weights


def _taps(image: Tensor, step: int):
    """Offset, weight and shifted image of each of 5 x 5 taps; zero beyond the border."""
    h, w = image.shape[2:]
    padded = F.pad(image, (MARGIN,) * 4)
    for j in range(-2, 3):
        for i in range(-2, 3):
            y, x = j * step, i * step
            neighbour = padded[..., MARGIN + y : MARGIN + y + h, MARGIN + x : MARGIN + x + w]
            yield y, x, B3[j + 2] * B3[i + 2], neighbour
