"""One frame through NTAS: plan from the previous image, sample, predict kernels, filter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.accumulate.memory import (
    History,
    Memory,
    empty_memory,
    reproject_image,
    reproject_memory,
    surface_weight,
    weigh_history,
    with_image,
)
from baselines.ntas import FAMILY
from baselines.ntas.network import Denoiser, DirectDenoiser, Networks
from baselines.oidn import equal_start
from baselines.oidn.equal_start import EqualStart
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.asking import next_age
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.ops.density import bounded_exp_density
from rlbench.ops.fireflies import mean_without_fireflies, repair_radiance_history
from rlbench.ops.reprojection import ReprojectionMemo, reproject
from rlbench.ops.transfer import log_forward, squash_depth
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
NO_HISTORY = -1.0  # network input where the history has no weight


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants, and the length of backpropagation through time."""

    denoiser: Callable[[], Denoiser | DirectDenoiser] = Denoiser  # makes the second network
    bptt: int = 2  # frames that training differentiates through, >= 1
    weighted_history: bool = False  # bicubic; weaker on other surfaces and where light changes


BASE = Config()
VARIANTS = {
    "": BASE,
    "direct": replace(BASE, denoiser=DirectDenoiser),  # are kernels needed?
    "history": replace(BASE, weighted_history=True),  # what do the rules of ours for history give?
}


class State(NamedTuple):
    """What the next frame needs of the previous one."""

    denoised: Float[Tensor, "n 3 h w"]  # the previous image, demodulated, linear
    age: int  # frames so far; at 0 `denoised` is meaningless
    memory: Memory | None = None  # that weighs the history; None: only its validity counts


@dataclass(frozen=True)
class Ntas:
    """Neural temporal adaptive sampling and denoising (Hasselgren et al. 2020).

    A U-Net maps the G-buffer and the reprojected previous image to the logarithm of the density;
    every pixel gets at least one sample. A second U-Net maps the G-buffer, the mean of the samples
    and the same history to kernels, which filter samples and history (see `network.Denoiser`).

    Ours, since only the paper's outline was at hand: both U-Nets are those of Open Image Denoise;
    colours enter them as `log_forward(radiance)`; the filtered signal is linear radiance over
    (albedo, the mean of 3 x 3 pixels, + 0.01), or over 1.01 where albedo is black, as for emitters
    and sky. The history is demodulated likewise, so that textures are not blurred from frame to
    frame; the networks see it modulated by the albedo of this frame. Fireflies are limited
    (rlbench.ops.limit_fireflies), and a pixel of broken history is replaced by a neighbour.

    The variant `direct` is NTAS as compared by Scardigli et al. 2023: in their release a U-Net
    predicts colours instead of kernels, which differs from Hasselgren et al. The variant keeps that
    release's loss (L1 of the image and of its change) and the ReLU on the output; for the rest see
    `network.DirectDenoiser`.

    The variant `history` weighs the history by the rules of `accumulate` and `ours`. The previous
    image is reprojected by bicubic taps in log transfer. Similarity of surfaces, and in `denoise`
    antilag confidence, multiply the kernels' weights of the history; where nothing is left, the
    networks read that there is none. NTAS itself accumulates no samples that antilag could compare,
    so the state also holds the memory of `accumulate`, which does; no network reads it.
    """

    networks: Networks
    config: Config = BASE
    traits: Traits = FAMILY.variants[""].traits
    memo: ReprojectionMemo[History] = field(
        default_factory=ReprojectionMemo, repr=False, compare=False
    )

    def start(self, size: Size) -> State:
        """A state without history."""
        device = next(self.networks.parameters()).device
        memory = empty_memory(size, device) if self.config.weighted_history else None
        return State(torch.zeros(size.n, 3, size.h, size.w, device=device), 0, memory)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """Density in (0, 1] with maximum 1: the bounded exponential of the sampler's output."""
        history, weight = _reproject_denoised(gbuffer, state)
        if state.memory is not None:
            weight = surface_weight(self.memo.get(gbuffer, state.memory, reproject_memory))
        albedo = demodulation_albedo(filtered_albedo(gbuffer.albedo))
        features = _sampler_input(gbuffer, albedo, history, weight)
        log_density: Tensor = self.networks.sampler(features)
        return bounded_exp_density(log_density)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image in linear radiance; the state is detached every `bptt` frames."""
        # reproject
        history, weight = _reproject_denoised(gbuffer, state)
        if (memory := state.memory) is not None:
            reprojected = self.memo.get(gbuffer, memory, reproject_memory)
            weight, memory = weigh_history(gbuffer, samples, memory, reprojected)

        # demodulate
        albedo = demodulation_albedo(filtered_albedo(gbuffer.albedo))
        noisy = mean_without_fireflies(samples.radiance, samples.counts)

        # predict kernels and filter
        features = _sampler_input(gbuffer, albedo, history, weight)
        features = torch.cat((log_forward(noisy), features), 1)
        denoised = self.networks.denoiser(features, noisy / albedo, history, weight)

        # modulate
        age = next_age(state.age)
        next_denoised = denoised.detach() if age % self.config.bptt == 0 else denoised
        image = denoised * albedo
        return image, State(next_denoised, age, with_image(memory, image))


def _reproject_denoised(
    gbuffer: GBuffer, state: State
) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 1 h w"]]:
    """The previous demodulated image as seen from this frame, zero where it is invalid.

    With its weight: 1 where it is valid.
    """
    move = reproject if state.memory is None else reproject_image
    history, valid = move(repair_radiance_history(state.denoised), gbuffer.motion)
    valid = valid & (state.age > 0)
    return history.where(valid, 0.0), valid.to(history.dtype)


def _sampler_input(
    gbuffer: GBuffer, albedo: Tensor, history: Tensor, weight: Tensor
) -> Float[Tensor, "n 10 h w"]:
    """Normal, albedo, depth and the previous image; the denoiser sees the samples as well."""
    previous = log_forward(history * albedo).where(weight > 0, NO_HISTORY)
    return torch.cat((gbuffer.normal, gbuffer.albedo, squash_depth(gbuffer.depth), previous), 1)


def build(variant: str, device: torch.device, weights: str | None) -> Ntas | EqualStart:
    """NTAS with pretrained weights (None), those of a file (its path), or "random" ones."""
    traits, file = FAMILY.variants[variant].traits, CARDS / FAMILY.weights_file(variant)
    if variant == "intel":
        return equal_start.build(traits, device, weights, file)
    config = VARIANTS[variant]
    networks = Networks(config.denoiser)
    if weights == "random":
        networks.init_weights(seed=0)
    load_for_inference(networks, weights, file, device)
    return Ntas(networks, config, traits)
