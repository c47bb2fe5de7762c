"""From the sampler's action to a sample density."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["DENSITIES", "ActionDensity", "ExponentialDensity", "LinearDensity"]

LOG_RANGE = 1.5  # logarithm of the density of action 1; action 0 has density 1


class ActionDensity(Protocol):
    """Density of an action. Actions outside [-1, 1] are clamped."""

    @property
    def multiplicative(self) -> bool:
        """Does a step of the action multiply the density by a factor, or add to it?"""

    def __call__(self, action: Float[Tensor, "*k n 1 h w"]) -> Float[Tensor, "*k n 1 h w"]:
        """The density, >= 0, at any scale."""


@dataclass(frozen=True)
class ExponentialDensity:
    """Density exp(1.5 action): it never reaches zero, and no pixel is excluded.

    Equal steps of the action are equal relative changes of the count, at both ends of the range.

    >>> ExponentialDensity()(torch.zeros(1, 1, 1, 2))
    tensor([[[[1., 1.]]]])
    """

    multiplicative: bool = True

    def __call__(self, action: Float[Tensor, "*k n 1 h w"]) -> Float[Tensor, "*k n 1 h w"]:
        """The density, in [exp(-1.5), exp(1.5)]."""
        return torch.exp(LOG_RANGE * action.clamp(-1, 1))


@dataclass(frozen=True)
class LinearDensity:
    """Density 1 + action: the height above the lowest possible action, as in `ours/paper`."""

    multiplicative: bool = False

    def __call__(self, action: Float[Tensor, "*k n 1 h w"]) -> Float[Tensor, "*k n 1 h w"]:
        """The density, in [0, 2]."""
        return 1 + action.clamp(-1, 1)


DENSITIES: Mapping[str, ActionDensity] = {
    "exponential": ExponentialDensity(),
    "linear": LinearDensity(),
}
