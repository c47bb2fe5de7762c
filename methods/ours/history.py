"""What a variant remembers: the state between frames, and its reprojection to a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from methods.ours import HistoryMode
from methods.ours.networks import GBUFFER_CHANNELS, MISSING
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import (
    AccumulatedRadiance,
    feature_similarity,
    is_cut,
    surface_features,
)
from rlbench.ops.color import luminance
from rlbench.ops.radiance_history import (
    find_static_pixels,
    repair_spp,
    reproject_radiance,
    weigh_by_similarity,
)
from rlbench.ops.reprojection import reproject
from rlbench.ops.sanitize import repair_history
from rlbench.ops.transfer import log_forward

MANY_SPP = 16.0  # accumulated samples that networks read as 1/2
MIN_SPP = 0.01  # a previous budget below this is read as this
MAX_FEATURE = 4.0  # latents lie in [-1, 1]; encoded samples reach 3.7 at radiance 65504
BILINEAR_CHANNELS = [1, GBUFFER_CHANNELS]  # accumulated spp, G-buffer features


@dataclass(frozen=True, eq=False)
class RecurrentState:
    """All that `ours` carries from one frame to the next, at the pixels of the earlier frame.

    A variant that does not accumulate radiance stores `features` only: every other tensor then has
    zero channels.
    """

    features: Float[Tensor, "n _ h w"]  # latent, or encoded samples; MISSING before frame 0
    radiance: AccumulatedRadiance
    image: Float[Tensor, "n _ h w"]  # previous output, linear radiance
    gbuffer_features: Float[Tensor, "n _ h w"]  # of the previous frame
    previous_spp: Float[Tensor, "n _ 1 1"]  # samples per pixel of the previous frame; 1 at first
    age: int  # frames seen so far

    @classmethod
    def of_features(cls, features: Float[Tensor, "n c h w"], age: int) -> RecurrentState:
        """A state without accumulated radiance."""
        none = features.new_empty(len(features), 0, *features.shape[-2:])
        spp = none.new_empty(len(features), 0, 1, 1)
        return cls(features, AccumulatedRadiance(none, none, none), none, none, spp, age)


class ReprojectedHistory(NamedTuple):
    """The recurrent state at the pixels of the current frame, known before it is sampled.

    A variant that does not accumulate radiance has `sampler_inputs` and `features` only: every
    other tensor then has zero channels.
    """

    # what networks read: G-buffer, features, radiance; for the sampler also the logarithm of the
    # previous frame's spp, since a map that gains with many samples is too bold with few
    sampler_inputs: Float[Tensor, "n c h w"]
    features: Float[Tensor, "n c2 h w"]  # MISSING where the history is not valid
    radiance: AccumulatedRadiance  # weight 0 where the history is not valid
    image: Float[Tensor, "n 3 h w"]  # previous output, log transfer
    similarity: Float[Tensor, "n 1 h w"]  # of surfaces before and now, in [0, 1]; 0 if not valid
    static_mask: Bool[Tensor, "n 1 h w"]  # True where the same surface did not move
    previous_spp: Float[Tensor, "n _ 1 1"]

    @property
    def inputs(self) -> Float[Tensor, "n c h w"]:
        """What the encoder reads: all but the previous frame's spp."""
        return self.sampler_inputs[:, : self.sampler_inputs.shape[1] - self.previous_spp.shape[1]]

    def with_confidence(self, confidence: Float[Tensor, "n 1 h w"]) -> ReprojectedHistory:
        """The history with its weight and similarity multiplied by a confidence in [0, 1]."""
        radiance = self.radiance.scale_weight(confidence)
        return self._replace(radiance=radiance, similarity=self.similarity * confidence)

    @classmethod
    def of_features(
        cls, inputs: Float[Tensor, "n c h w"], features: Float[Tensor, "n c2 h w"]
    ) -> ReprojectedHistory:
        """A history without accumulated radiance."""
        none = inputs.new_empty(len(inputs), 0, *inputs.shape[-2:])
        radiance, spp = AccumulatedRadiance(none, none, none), none.new_empty(len(inputs), 0, 1, 1)
        return cls(inputs, features, radiance, none, none, none.bool(), spp)


def detach(state: RecurrentState) -> RecurrentState:
    """The same state, cut from the autograd graph."""
    return replace(
        state,
        features=state.features.detach(),
        radiance=AccumulatedRadiance(*(part.detach() for part in state.radiance)),
        image=state.image.detach(),
        gbuffer_features=state.gbuffer_features.detach(),
    )


def gbuffer_features(gbuffer: GBuffer) -> Float[Tensor, "n 7 h w"]:
    """The G-buffer as networks read it: normal, albedo, 1 / (1 + depth)."""
    return surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)


def radiance_statistics(radiance: AccumulatedRadiance) -> Float[Tensor, "n 2 h w"]:
    """Network inputs: relative deviation and weight, both in [0, 1)."""
    deviation = radiance.variance.clamp_min(1e-8).sqrt()
    relative = deviation / (deviation + luminance(radiance.mean) + 1e-3)
    weight = radiance.accumulated_spp / (radiance.accumulated_spp + MANY_SPP)
    return torch.cat((relative, weight), 1)


class DenoisedFrame(NamedTuple):
    """All results of one frame, of which the history selects what to remember."""

    gbuffer: GBuffer
    samples: Samples
    encoded: Float[Tensor, "n c h w"]  # samples as the encoder reads them
    latent: Float[Tensor, "n c2 h w"]
    radiance: AccumulatedRadiance
    image: Float[Tensor, "n 3 h w"]  # linear radiance


@dataclass(frozen=True)
class FeatureHistory:
    """Features of the previous frame, reprojected by bilinear taps: its latent or its samples.

    With the mode "nothing" there are none: every frame by itself. Motion vectors are not read then.
    """

    mode: HistoryMode
    channels: int  # of the features
    bptt: int = 1  # frames that gradients flow back through

    def start(self, size: Size, device: torch.device) -> RecurrentState:
        """The state before the first frame: MISSING everywhere."""
        return RecurrentState.of_features(_missing(self.channels, size, device), 0)

    def reproject(self, gbuffer: GBuffer, state: RecurrentState) -> ReprojectedHistory:
        """The state at the pixels of the current frame; MISSING where it is not valid."""
        features = self.truncate(state).features
        if self.channels:
            features = repair_history(features, -1.0, MAX_FEATURE)
            features, valid = reproject(features, gbuffer.motion)
            features = features.where(valid & (state.age > 0), MISSING)
        inputs = torch.cat((gbuffer_features(gbuffer), features), dim=1)
        return ReprojectedHistory.of_features(inputs, features)

    def remember(self, frame: DenoisedFrame, age: int) -> RecurrentState:
        """The state after a frame."""
        features = frame.encoded if self.mode == "samples" else frame.latent[:, : self.channels]
        return RecurrentState.of_features(features, age)

    def truncate(self, state: RecurrentState) -> RecurrentState:
        """The state, detached every `bptt` frames (truncated backpropagation through time)."""
        return state if state.age % self.bptt else detach(state)


@dataclass(frozen=True)
class RadianceHistory(FeatureHistory):
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
        valid = valid & ~is_cut(current, previous, valid)
        features = features.where(valid, MISSING)
        previous_image = state.image.clamp_min(0)
        mean, square, image = reproject_radiance(state.radiance, previous_image, gbuffer.motion)
        similarity = feature_similarity(current, previous).where(valid, 0.0)
        radiance = AccumulatedRadiance(mean, square, weigh_by_similarity(spp, similarity))
        statistics = radiance_statistics(radiance)
        accumulated = torch.cat((image, log_forward(mean), statistics, similarity), dim=1)
        static = find_static_pixels(similarity, gbuffer.motion)
        same_shot = valid.any(dim=3, keepdim=True).any(dim=2, keepdim=True)
        previous_spp = state.previous_spp.where(same_shot, 1.0)
        budget = previous_spp.clamp_min(MIN_SPP).log().expand_as(similarity)
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
