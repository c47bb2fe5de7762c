"""Importance ratios of a Gaussian policy over pixels: one for each pixel, or one for all."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

__all__ = ["joint_ratio", "pixel_ratios"]


def pixel_ratios(
    current: Float[Tensor, "*k p"],
    previous: Float[Tensor, "*k p"],
    action: Float[Tensor, "*k p"],
    action_std: Float[Tensor, "*k p"] | float,
) -> Float[Tensor, "*k p"]:
    """Probability of each pixel's action under the current mean over that under the previous one.

    `action_std` is the standard deviation of both.

    >>> import torch
    >>> mean = torch.zeros(2)
    >>> pixel_ratios(mean, mean, torch.ones(2), 0.3)
    tensor([1., 1.])
    """
    return log_ratios(current, previous, action, action_std).exp()


def joint_ratio(
    current: Float[Tensor, "*k p"],
    previous: Float[Tensor, "*k p"],
    action: Float[Tensor, "*k p"],
    action_std: Float[Tensor, "*k p"] | float,
) -> Float[Tensor, "*k"]:
    """The product over all pixels: the ratio of RLlib's APPO for an action with p values."""
    return log_ratios(current, previous, action, action_std).sum(-1).exp()


def log_ratios(
    current: Tensor, previous: Tensor, action: Tensor, action_std: Tensor | float
) -> Tensor:
    """Logarithms of `pixel_ratios`."""
    distance = (action - current).square() - (action - previous).square()
    return -distance / 2 / action_std**2
