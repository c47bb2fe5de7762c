"""What a learner of the sampler gets, and what it returns: a problem in, a loss out."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from rlbench.training.surrogate_gradient import SampleGradient


class Rollout(NamedTuple):
    """The results of k actions, each from the same frame and state."""

    errors: Float[Tensor, "k n 1 h w"]  # of each pixel of the image, >= 0, one realisation
    counts: Float[Tensor, "k n 1 h w"]  # samples drawn


class AllocationProblem(Protocol):
    """One frame in which a sampler acts: a toy problem, or `ours` with its denoiser."""

    @property
    def spp(self) -> float:
        """The budget, samples per pixel."""

    @property
    def min_samples(self) -> int:
        """Fewest samples of a pixel."""

    @property
    def max_samples(self) -> int:
        """Most samples of a pixel, at most what is stored."""

    @property
    def multiplicative(self) -> bool:
        """True if a step of the action multiplies the density by a factor; else it adds to it."""

    @property
    def observation(self) -> Float[Tensor, "n c h w"]:
        """The sampler's inputs, known before any sample is drawn; without gradient."""

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action, in [-1, 1]; each call has a new graph to its weights."""

    def relaxed_counts(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        """Samples per pixel before rounding: differentiable, at the exact budget."""

    def draw_counts(self, action: Float[Tensor, "n 1 h w"]) -> Int[Tensor, "n 1 h w"]:
        """Relaxed counts rounded at random, at the exact budget; the same in every call."""

    def evaluate_counts(self, counts: Int[Tensor, "k n 1 h w"]) -> Float[Tensor, "k n 1 h w"]:
        """Errors, as in a Rollout, of k sets of counts at any cost, without gradient.

        All sets read the same stored samples: n samples are the first n of the pixel.
        """

    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Draw samples and denoise for each of k actions, without gradient."""

    def surrogate_loss(self, sample_gradient: SampleGradient) -> Float[Tensor, ""]:
        """The loss of the mean action's image; its gradient reaches `act` by `sample_gradient`."""


class SamplerLearner(Protocol):
    """A way to train a sampler. It may be stateful: a critic has a replay buffer."""

    min_samples: int = 0  # fewest samples of a pixel that it can differentiate at
    # trained beside the sampler, by the same optimiser and loss
    network: nn.Module | None = None

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """A scalar whose gradient is one step of the sampler, and of `network`."""


class StepResult(NamedTuple):
    """The results of one action, and the next observation."""

    errors: Float[Tensor, "1 1 h w"]  # of each pixel of the image, >= 0
    counts: Float[Tensor, "1 1 h w"]  # samples drawn
    observation: Float[Tensor, "1 c h w"]  # of the next frame; of this one at the end
    truncated: bool  # was this the last frame of the episode?


class Env(Protocol):
    """Episodes of frames, one at a time; the action is a map. `methods.ours.problem` has one."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, rows and columns of an observation."""

    def reset(self) -> Float[Tensor, "1 c h w"]:
        """Start the next episode; returns the observation of its first frame."""

    def step(self, action: Float[Tensor, "1 1 h w"]) -> StepResult:
        """Draw samples by an action, denoise, and go on to the next frame."""
