"""The discounted return of every pixel: later rewards, carried back along the motion."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.ops.reprojection import reproject

__all__ = ["carry_back", "discounted_return"]


def discounted_return(
    rewards: Sequence[Float[Tensor, "k n 1 h w"]],
    motions: Sequence[Float[Tensor, "n 2 h w"] | None],
    gamma: float,
) -> Float[Tensor, "k n 1 h w"]:
    """Rewards of consecutive frames, at the pixels of the first: r0 + gamma (r1 + gamma (...)).

    `motions` are those of the second and later frames, to the frame before, in pixels. A later
    reward counts where the history of its pixel came from (`carry_back`), because a sample is
    worth something later at the place to which its surface has moved.

    >>> frames = [torch.full((1, 1, 1, 2, 2), reward) for reward in (1.0, 2.0, 4.0)]
    >>> float(discounted_return(frames, [None, None], gamma=0.5).mean())  # 1 + 2 / 2 + 4 / 4
    3.0
    """
    total = rewards[-1]
    for reward, motion in zip(rewards[-2::-1], motions[::-1], strict=True):
        total = reward + gamma * carry_back(total, motion)
    return total


def carry_back(
    values: Float[Tensor, "k n 1 h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> Float[Tensor, "k n 1 h w"]:
    """Values of the current frame's pixels, at their positions in the previous frame.

    The transpose of `reproject`: a value is shared between the four pixels that its history is
    interpolated from, in proportion to their weights. Values without a history are dropped.
    """
    ours = values.squeeze(2).transpose(0, 1)  # n k h w
    with torch.enable_grad():
        history = torch.zeros_like(ours, requires_grad=True)
        moved, valid = reproject(history, motion)
        (carried,) = torch.autograd.grad(moved, history, ours * valid)
    return carried.transpose(0, 1).unsqueeze(2)
