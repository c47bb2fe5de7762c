"""The filter: three spatial passes of growing dilation, the last one joined by the past image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from baselines.imcd.network import Kernels
from rlbench.ops.affinity import affinity_sum, cross_affinity_sum

DILATIONS = (1, 2, 4)  # pixels between taps, one a pass
NONE = 1e-10  # added to sums of weights, eq. 6 and 8


@dataclass(frozen=True)
class KernelSizes:
    """Sides of the windows that are averaged over.

    11 as one reimplementation of Isik et al. 2021 has it; another has 7, to save memory, which
    here does not grow with them. The paper's own could not be verified.
    """

    spatial: int = 11  # taps, odd
    temporal: int = 11  # taps, odd


class PreviousFrame(NamedTuple):
    """What the last frame left, moved to where it is now; finite everywhere."""

    features: Float[Tensor, "n 8 h w"]
    image: Float[Tensor, "n 3 h w"]  # over its reflectance, linear
    valid: Bool[Tensor, "n 1 h w"]


def apply_affinity_kernels(
    light: Float[Tensor, "n 3 h w"],
    kernels: Kernels,
    past: PreviousFrame | None,
    windows: KernelSizes,
) -> Float[Tensor, "n 3 h w"]:
    """Light averaged with what is alike: eq. 4, 6, 7 and 8 of Isik et al. 2021.

    Pass k = 0, 1, 2 takes neighbours q of p at dilation 1, 2, 4 with weights
    exp(-a_k(p) |f^k_p - f^k_q|^2), and p itself with c_k. The last pass also takes the past image,
    undilated, p included, with weights exp(-b_p |f^2_p - g_q|^2), g being the moved features of the
    last frame. The sums are divided by those of weights, plus 1e-10.

    Ours: beyond the border there are no neighbours, and of the past none where it is not valid.
    """
    ones = torch.ones_like(light[:, :1])
    for k, dilation in enumerate(DILATIONS):
        features, sharpness = kernels.features[:, k], kernels.sharpness[:, k]
        source = torch.cat((light, ones), 1)
        total = kernels.centre_weight[:, k] * source
        total = total + affinity_sum(features, sharpness, source, windows.spatial, dilation)
        if past is not None and k == len(DILATIONS) - 1:
            trusted = torch.cat((past.image, ones), 1) * past.valid
            total = total + cross_affinity_sum(
                features, kernels.temporal_sharpness, past.features, trusted, windows.temporal
            )
        light = total[:, :3] / (total[:, 3:] + NONE)
    return light
