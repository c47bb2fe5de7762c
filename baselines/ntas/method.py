"""Plan from the last image, then filter what was bought with it: the two halves of NTAS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from baselines.ntas import FAMILY
from baselines.ntas.network import Denoiser, Direct, Networks
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.ops.density import bounded_exp_density
from rlbench.ops.reprojection import reproject
from rlbench.ops.transfer import log_forward, squash_depth
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
MISSING = -1.0  # what a network sees where there is no history
LARGEST = 65504.0  # radiance above this, the largest half, is cut


@dataclass(frozen=True)
class Config:
    """What of NTAS is a choice."""

    denoiser: Callable[[], Denoiser | Direct] = Denoiser  # makes the second network
    bptt: int = 2  # frames that training differentiates through, >= 1


BASE = Config()
VARIANTS = {
    "": BASE,
    "direct": replace(BASE, denoiser=Direct),  # are kernels needed?
}


class State(NamedTuple):
    """What is remembered of the frames so far."""

    light: Float[Tensor, "n 3 h w"]  # the last image over its reflectance, linear
    age: int  # frames so far; at 0 `light` means nothing


@dataclass(frozen=True)
class Ntas:
    """Neural temporal adaptive sampling and denoising (Hasselgren et al. 2020).

    The density is the exponential of a U-Net that sees the view and the last image, moved to
    where it is now; every pixel gets one sample or more. A second U-Net sees the view, the mean of
    the samples and the same history, and filters them by kernels (see `network.Denoiser`).

    Ours, since of the paper only the outline was at hand: both U-Nets are that of Open Image
    Denoise; colours enter them as `log_forward(radiance)`; what is filtered is linear radiance over
    (albedo, the mean of 3x3 pixels, + 0.01), or over 1.01 where it is black as it is for lights and
    sky; what is remembered is likewise free of albedo, so that texture is not blurred from frame to
    frame and the last image is shown to the networks with the albedo of this frame. Of the means
    of samples those that are NaN or negative enter as 0, those above 65504 as 65504, as OIDN has
    it; history that is not finite is missing.

    Variant `direct` is NTAS as it was compared by Scardigli et al. 2023: their release has a U-Net
    that says colours in place of kernels, which is not Hasselgren's. Of that it keeps the loss (L1
    of the image and of its change) and the ReLU on what is said; for the rest see `network.Direct`.
    """

    networks: Networks
    config: Config = BASE
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> State:
        """Nothing is remembered."""
        weight = next(self.networks.parameters())
        return State(torch.zeros(size.n, 3, size.h, size.w, device=weight.device), age=0)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """Density in (0, 1], 1 where it is largest: the exponential of the sampler's map."""
        seen = _seen(
            gbuffer, demodulation_albedo(filtered_albedo(gbuffer.albedo)), *_history(gbuffer, state)
        )
        wish: Tensor = self.networks.sampler(seen)
        return bounded_exp_density(wish)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image by kernels on samples and history; state is cut off each `bptt` frames."""
        noisy = samples.mean.nan_to_num(0.0, posinf=LARGEST, neginf=0.0).clamp(0, LARGEST)
        history, valid = _history(gbuffer, state)
        reflectance = demodulation_albedo(filtered_albedo(gbuffer.albedo))
        seen = torch.cat((log_forward(noisy), _seen(gbuffer, reflectance, history, valid)), 1)
        light = self.networks.denoiser(seen, noisy / reflectance, history, valid)
        age = state.age + 1
        remembered = light.detach() if age % self.config.bptt == 0 else light
        return light * reflectance, State(remembered, age)


def _history(
    gbuffer: GBuffer, state: State
) -> tuple[Float[Tensor, "n 3 h w"], Bool[Tensor, "n 1 h w"]]:
    """The light of the last frame as seen from this one, zero where it is not valid."""
    moved, valid = reproject(state.light, gbuffer.motion)
    valid = valid & torch.isfinite(moved).all(1, keepdim=True) & (state.age > 0)
    return moved.where(valid, 0.0), valid


def _seen(
    gbuffer: GBuffer, reflectance: Tensor, history: Tensor, valid: Tensor
) -> Float[Tensor, "n 10 h w"]:
    """What both networks see: normal, albedo, depth and the last image."""
    last = log_forward(history * reflectance).where(valid, MISSING)
    return torch.cat((gbuffer.normal, gbuffer.albedo, squash_depth(gbuffer.depth), last), 1)


def build(variant: str, device: torch.device, weights: str | None) -> Ntas:
    """NTAS with shipped weights, those of a file, or random ones."""
    config = VARIANTS[variant]
    networks = Networks(config.denoiser)
    if weights == "random":
        networks.draw(seed=0)
    load_for_inference(networks, weights, CARDS / FAMILY.weights_file(variant), device)
    return Ntas(networks, config, FAMILY.variants[variant].traits)
