"""What a variant remembers: its first state, reprojection to a frame, and the state after it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.networks import GBUFFER_CHANNELS
from methods.ours.sample_encoding import MISSING
from methods.ours.state import (
    RecurrentState,
    ReprojectedHistory,
    detach,
    gbuffer_features,
    log_spp,
    network_features,
)
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import AccumulatedRadiance, feature_similarity
from rlbench.ops.radiance_history import (
    find_static_pixels,
    repair_spp,
    reproject_radiance,
    weigh_by_similarity,
)
from rlbench.ops.reprojection import reproject
from rlbench.ops.sanitize import repair_history

__all__ = [
    "DenoisedFrame",
    "HistoryModel",
    "LatentHistory",
    "NoHistory",
    "RadianceHistory",
    "SampleHistory",
]

MAX_FEATURE = 4.0  # latents lie in [-1, 1]; encoded samples reach 3.7 at radiance 65504
BILINEAR_CHANNELS = [1, GBUFFER_CHANNELS]  # accumulated spp, G-buffer features


class DenoisedFrame(NamedTuple):
    """All results of one frame; a HistoryModel selects what to remember."""

    gbuffer: GBuffer
    samples: Samples
    encoded: Float[Tensor, "n c h w"]  # samples as the encoder reads them
    latent: Float[Tensor, "n c2 h w"]
    radiance: AccumulatedRadiance
    image: Float[Tensor, "n 3 h w"]  # linear radiance


class HistoryModel(Protocol):
    """Decides what is carried from frame to frame."""

    def start(self, size: Size, device: torch.device) -> RecurrentState:
        """The state before the first frame."""

    def reproject(self, gbuffer: GBuffer, state: RecurrentState) -> ReprojectedHistory:
        """The state at the pixels of the current frame."""

    def remember(self, frame: DenoisedFrame, age: int) -> RecurrentState:
        """The state after a frame."""


@dataclass(frozen=True)
class NoHistory:
    """Nothing: every frame by itself. Motion vectors are not read."""

    def start(self, size: Size, device: torch.device) -> RecurrentState:
        """A state of zero channels."""
        n, h, w = size
        return RecurrentState.of_features(torch.empty(n, 0, h, w, device=device), 0)

    def reproject(self, gbuffer: GBuffer, state: RecurrentState) -> ReprojectedHistory:
        """The G-buffer features alone."""
        return ReprojectedHistory.of_features(gbuffer_features(gbuffer), state.features)

    def remember(self, frame: DenoisedFrame, age: int) -> RecurrentState:
        """A state of zero channels."""
        return RecurrentState.of_features(frame.latent[:, :0], age)


@dataclass(frozen=True)
class LatentHistory:
    """The latent of the previous frame, reprojected by bilinear taps."""

    channels: int
    bptt: int = 1  # frames that gradients flow back through

    def start(self, size: Size, device: torch.device) -> RecurrentState:
        """MISSING everywhere."""
        return RecurrentState.of_features(_missing(self.channels, size, device), 0)

    def reproject(self, gbuffer: GBuffer, state: RecurrentState) -> ReprojectedHistory:
        """The previous latent at the current pixels; MISSING where it is not valid."""
        state = self.truncate(state)
        features = repair_history(state.features, -1.0, MAX_FEATURE)
        features, valid = reproject(features, gbuffer.motion)
        features = features.where(valid & (state.age > 0), MISSING)
        inputs = torch.cat((gbuffer_features(gbuffer), features), dim=1)
        return ReprojectedHistory.of_features(inputs, features)

    def remember(self, frame: DenoisedFrame, age: int) -> RecurrentState:
        """The latent."""
        return RecurrentState.of_features(frame.latent, age)

    def truncate(self, state: RecurrentState) -> RecurrentState:
        """The state, detached every `bptt` frames (truncated backpropagation through time)."""
        return state if state.age % self.bptt else detach(state)


@dataclass(frozen=True)
class SampleHistory(LatentHistory):
    """The encoded samples of the previous frame."""

    def remember(self, frame: DenoisedFrame, age: int) -> RecurrentState:
        """The encoded samples."""
        return RecurrentState.of_features(frame.encoded, age)


@dataclass(frozen=True)
class RadianceHistory(LatentHistory):
    """The latent, accumulated radiance, previous image and G-buffer.

    Radiance and image are reprojected by bicubic taps, since bilinear ones blur a little more in
    every frame; the other tensors by bilinear taps.
    """

    def start(self, size: Size, device: torch.device) -> RecurrentState:
        """MISSING features, radiance of weight 0, and a previous budget of 1 spp."""
        n, h, w = size
        zero = torch.zeros(n, 1, h, w, device=device)
        black = zero.expand(-1, 3, -1, -1)
        return RecurrentState(
            features=_missing(self.channels, size, device),
            radiance=AccumulatedRadiance(black.clone(), zero.clone(), zero.clone()),
            image=black.clone(),
            gbuffer_features=zero.expand(-1, GBUFFER_CHANNELS, -1, -1).clone(),
            previous_spp=torch.ones(n, 1, 1, 1, device=device),
            age=0,
        )

    def reproject(self, gbuffer: GBuffer, state: RecurrentState) -> ReprojectedHistory:
        """Everything at the current pixels; radiance is weighted by surface similarity."""
        state = self.truncate(state)
        current = gbuffer_features(gbuffer)
        features, spp, previous, valid = self._bilinear(gbuffer, state)
        features = features.where(valid, MISSING)
        previous_image = state.image.clamp_min(0)
        mean, square, image = reproject_radiance(state.radiance, previous_image, gbuffer.motion)
        similarity = feature_similarity(current, previous).where(valid, 0.0)
        radiance = AccumulatedRadiance(mean, square, weigh_by_similarity(spp, similarity))
        accumulated = torch.cat((image, network_features(radiance), similarity), dim=1)
        static = find_static_pixels(similarity, gbuffer.motion)
        same_shot = valid.any(dim=3, keepdim=True).any(dim=2, keepdim=True)
        previous_spp = state.previous_spp.where(same_shot, 1.0)
        budget = log_spp(previous_spp).expand_as(similarity)
        inputs = torch.cat((current, features, accumulated.where(valid, MISSING), budget), dim=1)
        return ReprojectedHistory(
            inputs, features, radiance, image, similarity, static, previous_spp
        )

    def remember(self, frame: DenoisedFrame, age: int) -> RecurrentState:
        """Latent, radiance, image, G-buffer features and the mean number of samples per pixel."""
        return RecurrentState(
            features=frame.latent,
            radiance=frame.radiance,
            image=frame.image,
            gbuffer_features=gbuffer_features(frame.gbuffer),
            previous_spp=frame.samples.counts.float().mean((1, 2, 3), keepdim=True),
            age=age,
        )

    def _bilinear(
        self, gbuffer: GBuffer, state: RecurrentState
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Features, accumulated spp, G-buffer features, and the mask of valid history."""
        stacked = (
            repair_history(state.features, -1.0, MAX_FEATURE),
            repair_spp(state.radiance.accumulated_spp),
            repair_history(state.gbuffer_features, -1.1, 1.1),
        )
        moved, valid = reproject(torch.cat(stacked, dim=1), gbuffer.motion)
        features, spp, previous = moved.split_with_sizes([self.channels, *BILINEAR_CHANNELS], 1)
        return features, spp, previous, valid & (state.age > 0)


def _missing(channels: int, size: Size, device: torch.device) -> Tensor:
    n, h, w = size
    return torch.full((n, channels, h, w), MISSING, device=device)
