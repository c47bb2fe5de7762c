"""The sampler's world: reset, act on every pixel, see what came of it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from jaxtyping import Float
from torch import Tensor

OUTCOMES = 2  # channels after what is seen: error and counts of the action before


class StepResult(NamedTuple):
    """What came of one action, and what is seen next."""

    errors: Float[Tensor, "1 1 h w"]  # of each pixel of the image, >= 0
    counts: Float[Tensor, "1 1 h w"]  # samples bought
    seen: Float[Tensor, "1 c h w"]  # of the next frame; of the same at the end
    over: bool  # was that the last frame of the episode?


class Env(Protocol):
    """Episodes of frames, one at a time. `ours` with its networks behind can be one."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels seen, rows, columns."""

    def reset(self) -> Float[Tensor, "1 c h w"]:
        """Begin the next episode: what is seen of its first frame."""

    def step(self, action: Float[Tensor, "1 1 h w"]) -> StepResult:
        """Buy by an action, denoise, and go on to the next frame."""
