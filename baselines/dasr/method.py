"""One frame through DASR: one initial spp, a sampling map, adaptive samples, a denoising U-Net."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.dasr import FAMILY
from baselines.dasr.network import Networks
from baselines.oidn import equal_start
from baselines.oidn.equal_start import EqualStart
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.density import bounded_exp_density
from rlbench.ops.fireflies import mean_without_fireflies
from rlbench.ops.transfer import squash_depth
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
MAX_RADIANCE = 1e5  # radiance is clamped to this
ALBEDO_MEAN = 0.45
ALBEDO_STD = 0.45
NORMAL_STD = 0.45

Decode = Callable[[Float[Tensor, "n 3 h w"]], Float[Tensor, "n 3 h w"]]


def to_radiance(log_radiance: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Linear radiance in [0, 1e5] from the denoiser's output, log(1 + L)."""
    return log_radiance.expm1().clamp(0, MAX_RADIANCE)


@dataclass(frozen=True)
class Dasr:
    """Deep adaptive sampling for low sample count rendering (Kuznetsov et al. 2018).

    The pilot gives each pixel one sample. A U-Net maps their mean and the G-buffer to the logarithm
    of the density, and the rest of the budget is allocated so that all counts together follow the
    density with at least one sample per pixel. At 1 spp nothing is left to allocate. A second U-Net
    of the same shape denoises the mean of all samples. Frames are independent.

    As in the paper, the pilot, which decides where to sample, is part of that mean. The mean is
    therefore biased towards dark where a first sample missed the light; the `bias` metric shows it.

    From the training code behind `network.UNet`: colours enter as log(1 + L), and albedo and
    normals are normalised as there. Differs from it: there is no shadow buffer, which our clips
    lack; depth enters as 1 / (1 + depth), because ours is infinite for the background; the budget
    is met exactly, while there the map is rescaled five times; images are padded to a multiple of
    32 by repeating the border, not with zeros. Ours: fireflies are limited
    (rlbench.ops.limit_fireflies).
    """

    networks: Networks
    traits: Traits = FAMILY.variants[""].traits
    decode: Decode = field(default=to_radiance)  # denoiser's output to image

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Density in (0, 1] with maximum 1: the bounded exponential of the sampler's output."""
        return bounded_exp_density(self.networks.sampler(_network_input(gbuffer, samples)))

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The image in linear radiance, from the mean of all samples and the G-buffer."""
        return self.decode(self.networks.denoiser(_network_input(gbuffer, samples))), None


def _network_input(gbuffer: GBuffer, samples: Samples) -> Float[Tensor, "n 10 h w"]:
    """Input of both networks: log radiance, albedo, normal and depth."""
    noisy = mean_without_fireflies(samples.radiance, samples.counts)
    albedo, normal = (gbuffer.albedo - ALBEDO_MEAN) / ALBEDO_STD, gbuffer.normal / NORMAL_STD
    return torch.cat((noisy.log1p(), albedo, normal, squash_depth(gbuffer.depth)), 1)


def build(variant: str, device: torch.device, weights: str | None) -> Dasr | EqualStart:
    """DASR with pretrained weights (None), those of a file (its path), or "random" ones."""
    traits, file = FAMILY.variants[variant].traits, CARDS / FAMILY.weights_file(variant)
    if variant == "intel":
        return equal_start.build(traits, device, weights, file)
    networks = Networks()
    if weights == "random":
        networks.init_weights(seed=0)
    load_for_inference(networks, weights, file, device)
    return Dasr(networks, traits)
