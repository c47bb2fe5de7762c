"""The recurrent state, and the history that it becomes when it is reprojected to a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.frames import GBuffer
from rlbench.ops.accumulation import AccumulatedRadiance, surface_features
from rlbench.ops.color import luminance
from rlbench.ops.transfer import log_forward

__all__ = [
    "RecurrentState",
    "ReprojectedHistory",
    "detach",
    "gbuffer_features",
    "log_spp",
    "network_features",
]

MANY_SPP = 16.0  # accumulated samples that networks read as 1/2
MIN_SPP = 0.01  # a previous budget below this is read as this


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
    # previous frame's spp, since a map that pays with many samples is too bold with few
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


def log_spp(previous_spp: Float[Tensor, "n 1 1 1"]) -> Float[Tensor, "n 1 1 1"]:
    """The previous frame's samples per pixel as the sampler reads them."""
    return previous_spp.clamp_min(MIN_SPP).log()


def gbuffer_features(gbuffer: GBuffer) -> Float[Tensor, "n 7 h w"]:
    """The G-buffer as networks read it: normal, albedo, 1 / (1 + depth)."""
    return surface_features(gbuffer.normal, gbuffer.albedo, gbuffer.depth)


def network_features(radiance: AccumulatedRadiance) -> Float[Tensor, "n 5 h w"]:
    """Network inputs: mean in log transfer, relative deviation and weight, both in [0, 1)."""
    deviation = radiance.variance.clamp_min(1e-8).sqrt()
    relative = deviation / (deviation + luminance(radiance.mean) + 1e-3)
    weight = radiance.accumulated_spp / (radiance.accumulated_spp + MANY_SPP)
    return torch.cat((log_forward(radiance.mean), relative, weight), 1)
