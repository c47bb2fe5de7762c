"""What every policy optimiser is given, and what it gives back: one interface for all of them."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rlbench.training.surrogate_gradient import SampleGradient


class Rollout(NamedTuple):
    """What came of k actions that were tried from the same frame and state."""

    errors: Float[Tensor, "k n 1 h w"]  # of each pixel of the image, >= 0, one realisation
    counts: Float[Tensor, "k n 1 h w"]  # whole samples that were bought


class AllocationProblem(Protocol):
    """One frame in which a sampler must act: a known problem, or `ours` with a denoiser behind."""

    @property
    def spp(self) -> float:
        """The budget, samples per pixel."""

    @property
    def multiplicative(self) -> bool:
        """Does the density grow by factors with the action, or by steps?"""

    @property
    def seen(self) -> Float[Tensor, "n c h w"]:
        """What the sampler sees before anything is bought, without gradient."""

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action, in [-1, 1], with a gradient to its weights; anew each call."""

    def relaxed(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        """Samples a pixel that an action is due before rounding: differentiable, at full cost."""

    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Buy and denoise for each of k actions, from this frame and state, without gradient."""

    def surrogate_loss(self, teach: SampleGradient) -> Float[Tensor, ""]:
        """The loss of the mean action's image, whose gradient reaches `act` through `teach`."""


class SamplerLearner(Protocol):
    """A way to train a sampler; stateful, for prices, critics and replays are remembered."""

    @property
    def floor(self) -> int:
        """Least samples a pixel must have for this way of learning; situations must obey."""

    @property
    def network(self) -> nn.Module | None:
        """What it trains beside the sampler, by the same optimiser and the same loss."""

    def loss(self, situation: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """A scalar whose gradient is one step of the sampler, and of `network`."""
