"""One frame through IMCD: embed samples, reproject, predict affinities, blend, filter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.accumulate.memory import LightHistory, with_image
from baselines.imcd import FAMILY
from baselines.imcd.network import (
    EMBEDDING,
    FEATURES,
    Kernels,
    KernelSizes,
    Networks,
    PreviousFrame,
    apply_affinity_kernels,
)
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import surface_features
from rlbench.ops.asking import next_age
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.ops.fireflies import limit_fireflies
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
CHANNELS = (EMBEDDING, FEATURES)  # of the state's features: accumulated, and of the last pass


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants, and choices that the paper's outline leaves open."""

    kernel_sizes: KernelSizes = field(default_factory=KernelSizes)
    bptt: int = 2  # frames that training differentiates through, >= 1
    weighted_history: bool = False  # bicubic; weaker on other surfaces and where light changes


BASE = Config()
VARIANTS = {
    "": BASE,
    "history": replace(BASE, weighted_history=True),  # what do the rules of ours for history give?
}


@dataclass(frozen=True)
class Imcd:
    """Interactive Monte Carlo denoising using affinity of neural features (Isik et al. 2021).

    Every sample is embedded, and the embeddings are averaged to e_t. A U-Net maps e_t and the
    accumulated embedding to the kernels of three spatial passes and a temporal one (see
    `apply_affinity_kernels`): features, sharpness and centre weights; and to lambda, the weight of
    history. Embedding and noisy irradiance are accumulated over frames with lambda, eq. 3 and 5.
    Uniform sampling.

    The paper was not at hand: equations are those of two reimplementations. Ours: where there is no
    history, as in the first frame, e_t and the noisy irradiance take its place, so blending
    leaves them unchanged; irradiance is radiance over (albedo of 3 x 3 pixels + 0.01), or over 1.01
    where albedo is black, as for emitters and sky; depth enters as 1 / (1 + depth), and there is no
    roughness. Fireflies are limited (rlbench.ops.limit_fireflies), and a pixel of broken history is
    replaced by a neighbour.

    A frame takes about 2 kB per pixel, nearly all of it for the U-Net, at any kernel size; with
    samples, G-buffers and references that is below 2 GB at 720 x 720.

    The variant `history` weighs the history by the rules of `accumulate` and `ours`. Irradiance and
    the previous image are reprojected by bicubic taps, embedding and features by bilinear ones.
    Similarity of surfaces times antilag confidence is the share of the history, before lambda; the
    rest is e_t and the noisy irradiance. It multiplies the temporal kernel, too. Lambda follows no
    sample count, so antilag compares this frame with the memory of `accumulate`, which the state
    then also holds and no network reads.
    """

    networks: Networks
    config: Config = BASE
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> LightHistory:
        """A state without history."""
        device = next(self.networks.parameters()).device
        return LightHistory.empty(size, sum(CHANNELS), device, self.config.weighted_history)

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: LightHistory
    ) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: LightHistory
    ) -> tuple[Float[Tensor, "n 3 h w"], LightHistory]:
        """The image in linear radiance; the state is detached every `bptt` frames."""
        image, state, _ = self.denoise_with_kernels(gbuffer, samples, state)
        return image, state

    def denoise_with_kernels(
        self, gbuffer: GBuffer, samples: Samples, state: LightHistory
    ) -> tuple[Float[Tensor, "n 3 h w"], LightHistory, Kernels]:
        """As `denoise`, and the kernels that filtered the image."""
        # demodulate and embed
        albedo = demodulation_albedo(filtered_albedo(gbuffer.albedo))
        noisy, embedding = self._embed_samples(gbuffer, samples, albedo)

        # reproject; the current values take the place of history that has no weight
        history, weight = state.reproject(gbuffer, samples)
        history_embedding, history_features = history.features.split_with_sizes(CHANNELS, 1)
        history_embedding = torch.lerp(embedding, history_embedding, weight)
        history_irradiance = torch.lerp(noisy, history.irradiance, weight)

        # predict affinities and accumulate
        kernels = self.networks.predict_kernels(embedding, history_embedding)
        embedding = torch.lerp(embedding, history_embedding, kernels.history_weight)
        irradiance = torch.lerp(noisy, history_irradiance, kernels.history_weight)

        # filter and modulate
        previous = PreviousFrame(history_features, history.denoised, weight)
        denoised = apply_affinity_kernels(
            irradiance, kernels, previous if state.age else None, self.config.kernel_sizes
        )
        image = denoised * albedo
        features = torch.cat((embedding, kernels.features[:, -1]), 1)
        memory = with_image(history.memory, image)
        state = LightHistory(irradiance, denoised, features, next_age(state.age), memory)
        if state.age % self.config.bptt == 0:
            state = state.detach()
        return image, state, kernels

    def _embed_samples(
        self, gbuffer: GBuffer, samples: Samples, albedo: Tensor
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 32 h w"]]:
        """Mean irradiance of the samples, and the mean of their embeddings e_t."""
        radiance = limit_fireflies(samples.radiance, samples.counts)
        irradiance = radiance / albedo[:, None]
        features = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
        embedding = self.networks.encoder(irradiance.log1p(), features, samples.valid_mask)
        return irradiance.sum(1) / samples.counts.clamp_min(1), embedding


def build(variant: str, device: torch.device, weights: str | None) -> Imcd:
    """IMCD with pretrained weights (None), those of a file (its path), or "random" ones."""
    networks = Networks()
    if weights == "random":
        networks.init_weights(seed=0)
    load_for_inference(networks, weights, CARDS / FAMILY.weights_file(variant), device)
    return Imcd(networks, VARIANTS[variant], FAMILY.variants[variant].traits)
