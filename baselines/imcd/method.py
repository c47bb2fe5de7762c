"""One frame through IMCD: embed samples, reproject, predict affinities, blend, filter."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

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

__all__ = ["Config", "Imcd", "State", "build"]

CARDS = Path(__file__).parent / "cards"
MAX_FEATURE = 1e4  # in magnitude, of embeddings and features; usual ones are below 100
CHANNELS = (EMBEDDING, 3, FEATURES, 3)  # of the state's images, in their order


@dataclass(frozen=True)
class Config:
    """Choices that the paper's outline leaves open."""

    kernel_sizes: KernelSizes = field(default_factory=KernelSizes)
    bptt: int = 2  # frames that training differentiates through, >= 1


class State(NamedTuple):
    """What the next frame needs of the frames so far."""

    embedding: Float[Tensor, "n 32 h w"]  # accumulated over frames
    irradiance: Float[Tensor, "n 3 h w"]  # noisy, demodulated, accumulated over frames
    features: Float[Tensor, "n 8 h w"]  # of the last spatial pass
    denoised: Float[Tensor, "n 3 h w"]  # the previous image, demodulated, linear
    age: int  # frames so far; at 0 the images are meaningless

    def detach(self) -> State:
        """The same state without the autograd graph."""
        return State._make((*(image.detach() for image in self[:4]), self.age))


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
    """

    networks: Networks
    config: Config = Config()
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> State:
        """A state without history."""
        weight = next(self.networks.parameters())
        images = [torch.zeros(size.n, c, size.h, size.w, device=weight.device) for c in CHANNELS]
        return State._make((*images, 0))

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

        # reproject; without history, the current values take its place
        reprojected, valid = _reproject_state(gbuffer, state)
        history_embedding = reprojected.embedding.where(valid, embedding)
        history_irradiance = reprojected.irradiance.where(valid, noisy)

        # predict affinities and accumulate
        kernels = self.networks.predict_kernels(embedding, history_embedding)
        embedding = torch.lerp(embedding, history_embedding, kernels.history_weight)
        irradiance = torch.lerp(noisy, history_irradiance, kernels.history_weight)

        # filter and modulate
        previous = PreviousFrame(reprojected.features, reprojected.denoised, valid)
        denoised = apply_affinity_kernels(
            irradiance, kernels, previous if state.age else None, self.config.kernel_sizes
        )
        state = State(embedding, irradiance, kernels.features[:, -1], denoised, state.age + 1)
        if state.age % self.config.bptt == 0:
            state = state.detach()
        return denoised * albedo, state, kernels

    def _embed_samples(
        self, gbuffer: GBuffer, samples: Samples, albedo: Tensor
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 32 h w"]]:
        """Mean irradiance of the samples, and the mean of their embeddings e_t."""
        radiance = limit_fireflies(samples.radiance, samples.counts)
        irradiance = radiance / albedo[:, None]
        features = surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)
        embedding = self.networks.encoder(irradiance.log1p(), features, samples.valid_mask)
        return irradiance.sum(1) / samples.counts.clamp_min(1), embedding


def _reproject_state(gbuffer: GBuffer, state: State) -> tuple[State, Bool[Tensor, "n 1 h w"]]:
    """The state as seen from this frame, zero where it is invalid, and the validity mask."""
    if state.age == 0:
        return state, torch.zeros_like(state.irradiance[:, :1], dtype=torch.bool)
    repaired = (
        repair_history(state.embedding, -MAX_FEATURE, MAX_FEATURE),
        repair_radiance_history(state.irradiance),
        repair_history(state.features, -MAX_FEATURE, MAX_FEATURE),
        repair_radiance_history(state.denoised),
    )
    images, valid = reproject(torch.cat(repaired, 1), gbuffer.motion)
    parts = images.where(valid, 0.0).split_with_sizes(CHANNELS, 1)
    return State._make((*parts, state.age)), valid


def build(variant: str, device: torch.device, weights: str | None) -> Imcd:
    """IMCD with pretrained weights (None), those of a file (its path), or "random" ones."""
    networks = Networks()
    if weights == "random":
        networks.init_weights(seed=0)
    load_for_inference(networks, weights, CARDS / FAMILY.weights_file(variant), device)
    return Imcd(networks, traits=FAMILY.variants[variant].traits)
