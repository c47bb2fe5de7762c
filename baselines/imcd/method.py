"""One frame through IMCD: embed samples, reproject, predict affinities, blend, filter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.accumulate.memory import Memory, empty_memory, reproject_memory
from baselines.accumulate.weighted_history import reproject_images, weigh_history, with_image
from baselines.imcd import FAMILY
from baselines.imcd.filter import KernelSizes, PreviousFrame, apply_affinity_kernels
from baselines.imcd.network import EMBEDDING, FEATURES, Kernels, Networks
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import surface_features
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.ops.fireflies import limit_fireflies, repair_radiance_history
from rlbench.ops.reprojection import reproject
from rlbench.ops.sanitize import repair_history
from rlbench.weights import load_for_inference

__all__ = ["VARIANTS", "Config", "Imcd", "State", "build"]

CARDS = Path(__file__).parent / "cards"
MAX_FEATURE = 1e4  # in magnitude, of embeddings and features; usual ones are below 100
CHANNELS = (EMBEDDING, 3, FEATURES, 3)  # of the state's images, in their order


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


class State(NamedTuple):
    """What the next frame needs of the frames so far."""

    embedding: Float[Tensor, "n 32 h w"]  # accumulated over frames
    irradiance: Float[Tensor, "n 3 h w"]  # noisy, demodulated, accumulated over frames
    features: Float[Tensor, "n 8 h w"]  # of the last spatial pass
    denoised: Float[Tensor, "n 3 h w"]  # the previous image, demodulated, linear
    age: int  # frames so far; at 0 the images are meaningless
    memory: Memory | None = None  # that weighs the history; None: only its validity counts

    def detach(self) -> State:
        """The same state without the autograd graph."""
        return State._make((*(image.detach() for image in self[:4]), *self[4:]))


@dataclass(frozen=True)
class Imcd:
    """Interactive Monte Carlo denoising using affinity of neural features (Isik et al. 2021).

    Every sample is embedded, and the embeddings are averaged to e_t. A U-Net maps e_t and the
    accumulated embedding to the kernels of three spatial passes and a temporal one (see `filter`):
    features, sharpness and centre weights; and to lambda, the weight of history. Embedding and
    noisy irradiance are accumulated over frames with lambda, eq. 3 and 5. Uniform sampling.

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

    def start(self, size: Size) -> State:
        """A state without history."""
        device = next(self.networks.parameters()).device
        images = [torch.zeros(size.n, c, size.h, size.w, device=device) for c in CHANNELS]
        memory = empty_memory(size, device) if self.config.weighted_history else None
        return State._make((*images, 0, memory))

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image in linear radiance; the state is detached every `bptt` frames."""
        image, state, _ = self.denoise_with_kernels(gbuffer, samples, state)
        return image, state

    def denoise_with_kernels(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State, Kernels]:
        """As `denoise`, and the kernels that filtered the image."""
        # demodulate and embed
        albedo = demodulation_albedo(filtered_albedo(gbuffer.albedo))
        noisy, embedding = self._embed_samples(gbuffer, samples, albedo)

        # reproject; the current values take the place of history that has no weight
        if state.memory is None:
            reprojected, weight = _reproject_state(gbuffer, state)
        else:
            reprojected, weight = _reproject_weighted(gbuffer, samples, state, state.memory)
        history_embedding = torch.lerp(embedding, reprojected.embedding, weight)
        history_irradiance = torch.lerp(noisy, reprojected.irradiance, weight)

        # predict affinities and accumulate
        kernels = self.networks.predict_kernels(embedding, history_embedding)
        embedding = torch.lerp(embedding, history_embedding, kernels.history_weight)
        irradiance = torch.lerp(noisy, history_irradiance, kernels.history_weight)

        # filter and modulate
        previous = PreviousFrame(reprojected.features, reprojected.denoised, weight)
        denoised = apply_affinity_kernels(
            irradiance, kernels, previous if state.age else None, self.config.kernel_sizes
        )
        image = denoised * albedo
        features, memory = kernels.features[:, -1], with_image(reprojected.memory, image)
        state = State(embedding, irradiance, features, denoised, state.age + 1, memory)
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


def _reproject_state(gbuffer: GBuffer, state: State) -> tuple[State, Float[Tensor, "n 1 h w"]]:
    """The state as seen from this frame, zero where it is invalid, and its weight: 1 if valid."""
    if state.age == 0:
        return state, torch.zeros_like(state.irradiance[:, :1])
    repaired = (
        repair_history(state.embedding, -MAX_FEATURE, MAX_FEATURE),
        repair_radiance_history(state.irradiance),
        repair_history(state.features, -MAX_FEATURE, MAX_FEATURE),
        repair_radiance_history(state.denoised),
    )
    images, valid = reproject(torch.cat(repaired, 1), gbuffer.motion)
    parts = images.where(valid, 0.0).split_with_sizes(CHANNELS, 1)
    return State._make((*parts, state.age, None)), valid.to(images.dtype)


def _reproject_weighted(
    gbuffer: GBuffer, samples: Samples, state: State, memory: Memory
) -> tuple[State, Float[Tensor, "n 1 h w"]]:
    """As `_reproject_state`, with bicubic taps for light and image, and a weight by rule in [0, 1].

    Its memory already holds this frame, but for the image.
    """
    reprojected = reproject_memory(gbuffer, memory)
    weight, memory = weigh_history(gbuffer, samples, memory, reprojected)
    features = repair_history(
        torch.cat((state.embedding, state.features), 1), -MAX_FEATURE, MAX_FEATURE
    )
    irradiance, denoised, features = reproject_images(
        state.irradiance, state.denoised, features, gbuffer.motion
    )
    embedding, features = features.split_with_sizes((EMBEDDING, FEATURES), 1)
    return State(embedding, irradiance, features, denoised, state.age, memory), weight


def build(variant: str, device: torch.device, weights: str | None) -> Imcd:
    """IMCD with pretrained weights (None), those of a file (its path), or "random" ones."""
    networks = Networks()
    if weights == "random":
        networks.init_weights(seed=0)
    load_for_inference(networks, weights, CARDS / FAMILY.weights_file(variant), device)
    return Imcd(networks, VARIANTS[variant], FAMILY.variants[variant].traits)
