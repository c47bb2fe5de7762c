"""One frame through IMCD: embed samples, blend with memory, draw kernels, filter four times."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from baselines.imcd import FAMILY
from baselines.imcd.filter import Past, Windows, filtered
from baselines.imcd.network import EMBEDDING, FEATURES, Kernels, Networks
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.ops.reprojection import reproject
from rlbench.ops.transfer import squash_depth
from rlbench.weights import load_for_inference

CARDS = Path(__file__).parent / "cards"
LARGEST = 65504.0  # radiance above this, the largest half, is cut
CHANNELS = (EMBEDDING, 3, FEATURES, 3)  # of the state, in its order


@dataclass(frozen=True)
class Config:
    """What of IMCD is a choice."""

    windows: Windows = field(default_factory=Windows)
    bptt: int = 2  # frames that training differentiates through, >= 1


class State(NamedTuple):
    """What is remembered of the frames so far."""

    embedding: Float[Tensor, "n 32 h w"]  # blended over frames
    light: Float[Tensor, "n 3 h w"]  # noisy radiance over reflectance, blended over frames
    features: Float[Tensor, "n 8 h w"]  # of the last spatial pass
    image: Float[Tensor, "n 3 h w"]  # the last image over its reflectance, linear
    age: int  # frames so far; at 0 the rest means nothing

    def detach(self) -> State:
        """The same without its past's graph."""
        return State._make((*(image.detach() for image in self[:4]), self.age))


@dataclass(frozen=True)
class Imcd:
    """Interactive Monte Carlo denoising by affinity of neural features (Isik et al. 2021).

    Samples are embedded one by one and averaged; a U-Net sees the mean e_t and its memory, and
    gives features, sharpness and centre weights of three spatial passes and a temporal one (see
    `filter`), and the weight of memory, lambda. Embedding and noisy light are blended over
    frames by lambda, eq. 3 and 5.

    The paper was not at hand: equations are as two reimplementations have them. Ours: the U-Net
    sees e_t as memory where there is none, as in a first frame; there memory is e_t, so that
    blending leaves it; light is radiance over (albedo of 3x3 pixels + 0.01), or over 1.01 where
    the albedo is black, as it is for lights and sky; depth enters as 1 / (1 + depth), and there
    is no roughness. Of samples, what is NaN or negative enters as 0, what is above 65504 as 65504;
    memory that is not finite is missing.

    Memory: a frame takes some 2 kB a pixel, nearly all of it the U-Net's, whatever the windows;
    with samples, views and references that is below 2 GB at 720x720.
    """

    networks: Networks
    config: Config = Config()
    traits: Traits = FAMILY.variants[""].traits

    def start(self, size: Size) -> State:
        """Nothing is remembered."""
        weight = next(self.networks.parameters())
        empty = [torch.zeros(size.n, c, size.h, size.w, device=weight.device) for c in CHANNELS]
        return State._make((*empty, 0))

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """Uniform."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The image; state is cut off each `bptt` frames."""
        image, state, _ = self.step(gbuffer, samples, state)
        return image, state

    def step(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State, Kernels]:
        """The same with the kernels that the image was filtered by."""
        reflectance = demodulation_albedo(filtered_albedo(gbuffer.albedo))
        noisy, now = self._seen(gbuffer, samples, reflectance)

        # move memory here; where there is none, it is what is seen now
        moved, valid = _moved(gbuffer, state)
        memory = moved.embedding.where(valid, now)
        kernels = self.networks.kernels(now, memory)
        embedding = torch.lerp(now, memory, kernels.keep)
        light = torch.lerp(noisy, moved.light.where(valid, noisy), kernels.keep)

        past = Past(moved.features, moved.image, valid) if state.age else None
        image = filtered(light, kernels, past, self.config.windows)
        state = State(embedding, light, kernels.features[:, -1], image, state.age + 1)
        if state.age % self.config.bptt == 0:
            state = state.detach()
        return image * reflectance, state, kernels

    def _seen(
        self, gbuffer: GBuffer, samples: Samples, reflectance: Tensor
    ) -> tuple[Float[Tensor, "n 3 h w"], Float[Tensor, "n 32 h w"]]:
        """Mean light of the samples, and the mean of their embeddings e_t."""
        clean = samples.radiance.nan_to_num(0.0, posinf=LARGEST, neginf=0.0).clamp(0, LARGEST)
        light = clean / reflectance[:, None]
        shape = torch.cat((gbuffer.normal, gbuffer.albedo, squash_depth(gbuffer.depth)), 1)
        embedding = self.networks.encoder(light.log1p(), shape, samples.valid_mask)
        return light.sum(1) / samples.counts.clamp_min(1), embedding


def _moved(gbuffer: GBuffer, state: State) -> tuple[State, Bool[Tensor, "n 1 h w"]]:
    """The state as seen from this frame, and where it is valid; zero where it is not."""
    if state.age == 0:
        return state, torch.zeros_like(state.light[:, :1], dtype=torch.bool)
    moved, valid = reproject(torch.cat(state[:4], 1), gbuffer.motion)
    valid = valid & torch.isfinite(moved).all(1, keepdim=True)
    parts = moved.where(valid, 0.0).split_with_sizes(CHANNELS, 1)
    return State._make((*parts, state.age)), valid


def build(variant: str, device: torch.device, weights: str | None) -> Imcd:
    """IMCD with shipped weights, those of a file, or random ones."""
    networks = Networks()
    if weights == "random":
        networks.draw(seed=0)
    load_for_inference(networks, weights, CARDS / FAMILY.weights_file(variant), device)
    return Imcd(networks, traits=FAMILY.variants[variant].traits)
