"""One frame through NPPD: embed samples, reproject, predict weights, blend, filter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.accumulate.memory import LightHistory, with_image
from baselines.imcd.network import EMBEDDING
from baselines.nppd import FAMILY
from baselines.nppd.network import (
    LARGE_WIDTHS,
    STRIDE,
    WIDTHS,
    Networks,
    apply_partitioning_pyramid,
)
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import fill_holes, frame_radiance, surface_features
from rlbench.ops.asking import may_ask, next_age
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.ops.fireflies import limit_fireflies
from rlbench.ops.padding import crop, pad
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
MEAN_OFFSET = 1e-8  # added to the mean irradiance before division


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants."""

    widths: tuple[tuple[int, ...], ...] = WIDTHS  # channels at each level, fine to coarse
    weighted_history: bool = False  # bicubic; weaker on other surfaces and where light changes


BASE = Config()
VARIANTS = {
    "": BASE,
    "large": replace(BASE, widths=LARGE_WIDTHS),  # do the published widths gain?
    "history": replace(BASE, weighted_history=True),  # what do the rules of ours for history give?
}


@dataclass(frozen=True)
class Nppd:
    """Neural partitioning pyramids (Balint et al. 2023).

    Every sample is embedded, and the embeddings of a pixel are averaged. A U-Net maps light and
    embedding of the history and of this frame to the weights of a filter (see
    `apply_partitioning_pyramid`) and to lambda, the weight of history by which light and embedding
    are accumulated. Uniform sampling.

    Networks, inputs, filter and recurrence are those of the authors' release. Ours: the widths of
    the variant ""; light is radiance over (albedo of 3 x 3 pixels + 0.01), or over 1.01 where
    albedo is black, as for emitters and sky, while theirs is radiance; depth enters as
    1 / (1 + depth); one mean irradiance, of this frame, divides all inputs; light that a kernel
    spreads beyond the border is mirrored back, and is lost in the release. Where there is no
    history the U-Net reads zeros, as in the release, but lambda and mu blend the current values
    with themselves, so that no light is lost. A pixel without a sample gets one: the history, or
    else the mean of its neighbourhood. Fireflies are limited (rlbench.ops.limit_fireflies), and a
    pixel of broken history is replaced by a neighbour.

    The variant `history` weighs the history by the rules of `accumulate` and `ours`, as that of
    `baselines.imcd` does. The weight multiplies lambda; of the previous image it is the share
    before mu, and accumulated light is the rest. Where it is 0, the U-Net reads zeros.
    """

    networks: Networks
    config: Config = BASE
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> LightHistory:
        """A state without history."""
        device = next(self.networks.parameters()).device
        return LightHistory.empty(size, EMBEDDING, device, self.config.weighted_history)

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: LightHistory
    ) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: LightHistory
    ) -> tuple[Float[Tensor, "n 3 h w"], LightHistory]:
        """The image in linear radiance, and the state with its autograd graph."""
        h, w = gbuffer.depth.shape[-2:]

        # demodulate, reproject and embed
        albedo = demodulation_albedo(filtered_albedo(gbuffer.albedo))
        history, weight = state.reproject(gbuffer, samples)
        light = _sample_irradiance(gbuffer, samples, albedo, history.irradiance, weight)
        noisy = light.mean
        mean = noisy.mean((1, 2, 3), keepdim=True) + MEAN_OFFSET
        embedding = self._embed(gbuffer, light, mean)

        # predict weights
        colours = _compress(torch.cat((history.irradiance, noisy), 1) / mean)
        inputs = torch.cat((colours, history.features, embedding), 1)
        weights = self.networks.predict_weights(pad(inputs, STRIDE))

        # accumulate; without history, the current values take its place
        keep = crop(weights.input_history_weight, h, w) * weight
        irradiance = torch.lerp(noisy, history.irradiance, keep)
        embedding = torch.lerp(embedding, history.features, keep)

        # filter and modulate
        previous = torch.lerp(irradiance, history.denoised, weight)
        denoised = apply_partitioning_pyramid(
            pad(irradiance, STRIDE), pad(previous, STRIDE), weights
        )
        denoised = crop(denoised, h, w)
        image = denoised * albedo
        memory = with_image(history.memory, image)
        return image, LightHistory(irradiance, denoised, embedding, next_age(state.age), memory)

    def _embed(self, gbuffer: GBuffer, light: Samples, mean: Tensor) -> Float[Tensor, "n 32 h w"]:
        """The mean embedding of a pixel's samples of irradiance."""
        colours = _compress(light.radiance / mean[:, None])
        features = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
        embedding: Tensor = self.networks.encoder(colours, features, light.valid_mask)
        return embedding


def _compress(colour: Tensor) -> Tensor:
    """log(1 + x) of colours x over the mean, as the networks see them; 0 for negative samples."""
    return colour.clamp_min(0).log1p()


def _sample_irradiance(
    gbuffer: GBuffer, samples: Samples, albedo: Tensor, history: Tensor, weight: Tensor
) -> Samples:
    """Samples of irradiance, at least one per pixel.

    A pixel without a sample gets its history with its weight, and else its neighbourhood's mean.
    """
    radiance = limit_fireflies(samples.radiance, samples.counts)
    irradiance, is_empty = radiance / albedo[:, None], samples.counts == 0
    if may_ask(is_empty) and not is_empty.any():
        return Samples(irradiance, samples.counts)
    filled = fill_holes(frame_radiance(radiance, samples.counts), gbuffer.albedo).mean / albedo
    first = torch.where(is_empty, torch.lerp(filled, history, weight), irradiance[:, 0])
    irradiance = torch.cat((first[:, None], irradiance[:, 1:]), 1)
    return Samples(irradiance, samples.counts.clamp_min(1))


def build(variant: str, device: torch.device, weights: str | None) -> Nppd:
    """NPPD with pretrained weights (None), those of a file (its path), or "random" ones."""
    config = VARIANTS[variant]
    networks = Networks(config.widths)
    if weights == "random":
        networks.init_weights(seed=0)
    load_for_inference(networks, weights, CARDS / FAMILY.weights_file(variant), device)
    return Nppd(networks, config, FAMILY.variants[variant].traits)
