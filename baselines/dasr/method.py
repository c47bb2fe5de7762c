"""One frame through DASR: look at the first samples, ask for more, denoise the mean of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.dasr import FAMILY
from baselines.dasr.network import Networks
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.density import bounded_exp_density
from rlbench.ops.transfer import squash_depth
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
LARGEST = 1e5  # radiance above this is cut
ALBEDO = (0.45, 0.45)  # mean and deviation that albedo is normalised by
NORMAL = 0.45  # deviation that normals are divided by

Develop = Callable[[Float[Tensor, "n 3 h w"]], Float[Tensor, "n 3 h w"]]


def develop(value: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Linear radiance in [0, 1e5] from what the denoiser says, its log(1 + L)."""
    return value.expm1().clamp(0, LARGEST)


@dataclass(frozen=True)
class Dasr:
    """Deep adaptive sampling for low sample count rendering (Kuznetsov et al. 2018), one frame.

    The bench buys one sample for each pixel. The density is the exponential of a U-Net that sees
    their mean and the view, and the rest of the budget is bought so that all counts together follow
    it, each pixel at one or more; at 1 spp nothing is left. An equal U-Net denoises the mean of
    all samples. The samples that chose where to sample are part of that mean, as in the paper: it
    is biased, towards dark where a first sample missed the light, and the `bias` metric shows it.

    From the training code behind `network.UNet`: colours as log(1 + L), albedo and normals as
    normalised there. Differs from it: no shadow buffer, which our clips have not; depth as
    1 / (1 + depth), since ours is infinite for background; the budget is met exactly, where it
    rescales the map five times; borders are repeated, not zero, up to a multiple of 32. Ours: of
    the means of samples those that are NaN or negative enter as 0.
    """

    networks: Networks
    traits: Traits = FAMILY.variants[""].traits
    develop: Develop = field(default=develop)  # what the denoiser says to image

    def start(self, size: Size) -> None:
        """Nothing: every frame is its own."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Density in (0, 1], 1 where it is largest: the exponential of the sampler's map."""
        return bounded_exp_density(self.networks.sampler(_seen(gbuffer, samples)))

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The image, from the mean of all samples, albedo, normal and depth."""
        return self.develop(self.networks.denoiser(_seen(gbuffer, samples))), None


def _seen(gbuffer: GBuffer, samples: Samples) -> Float[Tensor, "n 10 h w"]:
    """What both networks see: colour, albedo, normal and depth."""
    noisy = samples.mean.nan_to_num(0.0, posinf=LARGEST, neginf=0.0).clamp(0, LARGEST)
    albedo, normal = (gbuffer.albedo - ALBEDO[0]) / ALBEDO[1], gbuffer.normal / NORMAL
    return torch.cat((noisy.log1p(), albedo, normal, squash_depth(gbuffer.depth)), 1)


def build(variant: str, device: torch.device, weights: str | None) -> Dasr:
    """DASR with shipped weights, those of a file, or random ones."""
    networks = Networks()
    if weights == "random":
        networks.draw(seed=0)
    load_for_inference(networks, weights, CARDS / FAMILY.weights_file(variant), device)
    return Dasr(networks, FAMILY.variants[variant].traits)
