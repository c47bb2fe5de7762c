"""Affinity filter: three spatial passes of growing dilation; the last has a temporal kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.imcd.network import Kernels
from rlbench.ops.affinity import affinity_sum, cross_affinity_sum

__all__ = ["KernelSizes", "PreviousFrame", "apply_affinity_kernels"]

DILATIONS = (1, 2, 4)  # pixels between taps, for each pass
EPS = 1e-10  # added to sums of weights, eq. 6 and 8


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
