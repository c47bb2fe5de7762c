"""The sampler's reinforcement-learning environment: reset, act on every pixel, observe."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from jaxtyping import Float
from torch import Tensor

__all__ = ["Env", "StepResult"]


class StepResult(NamedTuple):
    """The results of one action, and the next observation."""

    errors: Float[Tensor, "1 1 h w"]  # of each pixel of the image, >= 0
    counts: Float[Tensor, "1 1 h w"]  # samples drawn
    observation: Float[Tensor, "1 c h w"]  # of the next frame; of this one at the end
    truncated: bool  # was this the last frame of the episode?


class Env(Protocol):
    """Episodes of frames, one at a time; the action is a map. `methods.ours.environment` is one."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, rows and columns of an observation."""

    def reset(self) -> Float[Tensor, "1 c h w"]:
        """Start the next episode; returns the observation of its first frame."""

    def step(self, action: Float[Tensor, "1 1 h w"]) -> StepResult:
        """Draw samples by an action, denoise, and go on to the next frame."""
