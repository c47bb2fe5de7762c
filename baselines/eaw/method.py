"""One frame through EAW: demodulate albedo, five a-trous passes, modulate albedo."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.eaw import FAMILY
from baselines.eaw.filter import Config, filter_irradiance
from baselines.eaw.still import Still
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import reflectance, surface_mask
from rlbench.ops.fireflies import mean_without_fireflies
from rlbench.ops.sanitize import sanitize_radiance

__all__ = ["Eaw", "build"]


@dataclass(frozen=True)
class Eaw:
    """Edge-avoiding a-trous wavelet transform (Dammertz et al. 2010), used as a filter.

    Pass i averages 5 x 5 pixels with a step of 2^i, weighted by a B3 spline times w_rt * w_n * w_x:
    exponentials of negative squared distances in colour, normal and position. Uniform sampling,
    frames are independent.

    Not verified: that the width in colour halves from pass to pass. Ours: G-buffers hold no
    positions, so w_x compares log depth, which is independent of the scene's unit; colours are
    compared as log(1 + c), so that bright light does not dominate the edges; the filtered signal is
    radiance over albedo (its mean over 3 x 3 pixels), so that textures are not blurred; background
    and emitters that reflect nothing pass through unfiltered; the widths are the best of a grid on
    training clips (`python -m baselines.eaw.search`). Fireflies are limited before filtering
    (rlbench.ops.limit_fireflies).
    """

    config: Config = Config()
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The filtered image, linear radiance."""
        noisy, albedo = sanitize_radiance(samples.mean), reflectance(gbuffer.albedo)
        limited = mean_without_fireflies(samples.radiance, samples.counts)
        surface = surface_mask(gbuffer.albedo, gbuffer.depth)
        irradiance = filter_irradiance(self.config, limited / albedo, surface, gbuffer)
        return (irradiance * albedo).where(surface, noisy), None


def build(variant: str, device: torch.device, weights: str | None) -> Eaw | Still:
    """EAW with the default widths, on frames or on still pixels; it has no weights."""
    return Still(device=device) if variant == "still" else Eaw()
