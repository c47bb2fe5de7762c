"""Display transforms: linear radiance to values in [0, 1], the space in which people see images."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["encode_aces", "encode_display", "encode_hable"]

KNEE = 0.0031308  # IEC 61966-2-1: linear value below which the curve is a straight line
HALF_MAX = 65504.0  # largest half float: above it both filmic curves are at their end
ACES_INPUT = (  # linear sRGB to the working space of the fit
    (0.59719, 0.35458, 0.04823),
    (0.07600, 0.90834, 0.01566),
    (0.02840, 0.13383, 0.83777),
)
ACES_OUTPUT = (  # and back
    (1.60475, -0.53108, -0.07367),
    (-0.10208, 1.10813, -0.00605),
    (-0.00327, -0.07276, 1.07602),
)
ACES_GAMMA = 2.2  # of Noisebase, in place of the sRGB curve
HABLE_EXPOSURE = 1.758141  # of OIDN's trainer: 18 % grey stays in the middle
HABLE_WHITE = 11.2


def encode_display(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Clipped sRGB in [0, 1] from linear radiance, where 1.0 is display white.

    The transfer curve of IEC 61966-2-1 (1999), without quantisation. NaN stays NaN; infinity is
    clipped to 1. `rlbench.ops.color` has the same curve; it is repeated here because metrics import
    nothing from rlbench.

    >>> encode_display(torch.tensor([-1.0, 0.0, 0.214041, 1.0, 30.0]))
    tensor([0.0000, 0.0000, 0.5000, 1.0000, 1.0000])
    """
    linear = radiance.clamp(0, 1)
    curved = 1.055 * linear.clamp_min(KNEE) ** (1 / 2.4) - 0.055
    return curved.where(linear > KNEE, 12.92 * linear)


def encode_aces(radiance: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Radiance through Hill's fit of the ACES reference transform, then gamma 2.2, in [0, 1].

    The fit of Stephen Hill in BakingLab (Pettineo 2016, ACES.hlsl), which Noisebase (Balint et al.
    2023) applies before it writes 8-bit images. Radiance is clamped to [0, 65504] before.

    >>> encode_aces(torch.tensor([0.0, 0.18, 1.0, 100.0]).expand(1, 3, 1, 4))[0, 0]
    tensor([[0.0000, 0.3599, 0.8042, 1.0000]])
    """
    entered = _mix_channels(ACES_INPUT, radiance.clamp(0, HALF_MAX))
    numerator = entered * (entered + 0.0245786) - 0.000090537
    fitted = numerator / (entered * (0.983729 * entered + 0.4329510) + 0.238081)
    return _mix_channels(ACES_OUTPUT, fitted).clamp(0, 1) ** (1 / ACES_GAMMA)


def encode_hable(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Radiance through Hable's filmic curve, then sRGB, in [0, 1].

    Hable 2010, Uncharted 2: HDR Lighting; with the constants of Open Image Denoise's trainer
    (Afra 2019, training/color.py), which scores images after this curve. Radiance is clamped to
    [0, 65504] before.

    >>> encode_hable(torch.tensor([0.0, 0.18, 1.0, 100.0]))
    tensor([0.0000, 0.4614, 0.8152, 1.0000])
    """
    white = _filmic(torch.tensor(HABLE_WHITE))
    return encode_display(_filmic(radiance.clamp(0, HALF_MAX) * HABLE_EXPOSURE) / white)


def _filmic(x: Tensor) -> Tensor:
    """Hable's curve: shoulder 0.22, linear strength 0.3 and angle 0.1, toe 0.2, 0.01 and 0.3."""
    return (x * (0.22 * x + 0.03) + 0.002) / (x * (0.22 * x + 0.3) + 0.06) - 0.01 / 0.3


def _mix_channels(matrix: tuple[tuple[float, ...], ...], image: Tensor) -> Tensor:
    weights = torch.tensor(matrix, dtype=image.dtype, device=image.device)
    return torch.einsum("ij, nj... -> ni...", weights, image)
