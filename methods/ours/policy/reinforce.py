"""REINFORCE on blocks of pixels, with local credit and a price on samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from methods.ours.policy.learner import AllocationProblem, SamplerLearner

TINY = 1e-8  # avoids a division by zero where all actions have equal results
MIN_COUNT = 0.1  # samples; smaller usual counts are weighted as this


class RolloutBatch(NamedTuple):
    """Actions from the state of one frame, on one grid of blocks, and their results."""

    actions: Float[Tensor, "k n 1 h w"]  # drawn around the mean
    errors: Float[Tensor, "k n 1 h w"]  # of each pixel of the image
    counts: Float[Tensor, "k n 1 h w"]  # samples drawn
    corner: tuple[int, int]  # row and column of the first whole block
    multiplicative: bool = False  # does a step of the action multiply the density, or add to it?


@dataclass(frozen=True)
class BlockPolicyGradient:
    """REINFORCE, block by block.

    A denoiser spreads every sample over its neighbours, so one pixel's noise says nothing about one
    pixel's worth: actions are drawn for whole blocks, on a grid that is shifted each frame. The
    baseline is the mean of antithetic draws from the same frame and state. The budget couples the
    blocks: a sample more here is one fewer elsewhere, hence a price on samples. The advantage of a
    block is -(change of error in and around it + price * change of its count); the price is the
    least-squares slope of error against count.

    Differs from the paper, which gives one reward per frame to an APPO learner, whose joint ratio
    over all pixels leaves the clip range after one step.
    """

    action_std: float = 0.3  # standard deviation of the action, whose range is [-1, 1]
    draws: int = 4  # actions from one frame and state, an even number
    block: int = 8  # pixels, side of a block
    margin: int = 4  # pixels around a block whose error is credited to it
    price_weight: float = 1.0  # share of the price that is charged; 0 is an ablation
    advantage_clip: float = 3.0  # standard deviations

    def draw_corner(self, generator: torch.Generator) -> tuple[int, int]:
        """A random grid of blocks: row and column of its first whole block."""
        row, column = torch.randint(self.block, (2,), generator=generator).tolist()
        return row, column

    def explore(
        self, mean: Float[Tensor, "n 1 h w"], corner: tuple[int, int], generator: torch.Generator
    ) -> Float[Tensor, "n 1 h w"]:
        """An action drawn around the mean, with constant noise within a block."""
        n, _, h, w = mean.shape
        rows, columns = (1 + (side + self.block - 1) // self.block for side in (h, w))
        noise = torch.randn((n, 1, rows, columns), generator=generator).to(mean.device)
        noise = noise.repeat_interleave(self.block, 2).repeat_interleave(self.block, 3)
        top, left = (-at % self.block for at in corner)
        return mean.detach() + self.action_std * noise[..., top : top + h, left : left + w]

    def antithetic_actions(
        self, mean: Float[Tensor, "n 1 h w"], corner: tuple[int, int], generator: torch.Generator
    ) -> Float[Tensor, "k n 1 h w"]:
        """Actions around the mean, in antithetic pairs: the noise of one is minus the other's."""
        halves = [self.explore(mean, corner, generator) for _ in range(self.draws // 2)]
        return torch.stack([*halves, *(2 * mean.detach() - half for half in halves)])

    def loss(self, mean: Float[Tensor, "n 1 h w"], batch: RolloutBatch) -> Float[Tensor, ""]:
        """Minus the mean over whole blocks of advantage times log-probability of the action.

        The budget cancels a change that all densities of an image have in common, so this is
        removed from the gradient. The square of the mean action is added, else it would still drift
        to where tanh is flat.
        """
        error = self._block_sums(batch.errors - batch.errors.mean(0), batch.corner, self.margin)
        count = self._block_sums(batch.counts - batch.counts.mean(0), batch.corner)
        usual = self._block_sums(batch.counts.mean(0, keepdim=True), batch.corner)
        image = (0, 2, 3, 4)  # each image has a price of its own
        weight, common = budget_coupling(usual, batch.multiplicative)
        gain = advantage(error, count, weight, image, self.price_weight, self.advantage_clip)
        noise = self._block_sums(batch.actions - mean.detach(), batch.corner)
        moved = self._block_sums((mean - mean.detach()).unsqueeze(0), batch.corner)  # zero
        if self.price_weight:
            moved = remove_common_change(moved, common, image)
        distance = (noise - moved) / self.block**2 / self.action_std
        drift = mean.mean((1, 2, 3)).square().mean()
        return (gain * distance.square()).mean() / 2 + drift

    def _block_sums(
        self, values: Float[Tensor, "k n 1 h w"], corner: tuple[int, int], margin: int = 0
    ) -> Float[Tensor, "k n 1 _ _"]:
        """Sums over the whole blocks of a grid, each with `margin` pixels around it."""
        up, left = (min(margin, at) for at in corner)  # pixels available before the first block
        inside = values[..., corner[0] - up :, corner[1] - left :]
        side = self.block + 2 * margin
        padded = F.pad(inside.flatten(0, 1), (margin - left, margin, margin - up, margin))
        sums = F.avg_pool2d(padded, side, self.block) * side**2
        return sums.view(*inside.shape[:3], *sums.shape[-2:])


@dataclass
class BlockReinforce(SamplerLearner):
    """Rolls out several actions around the mean from one state, and compares their errors.

    Each set of actions is used for one step, so the ratio of new to old probability is 1 and the
    clipping of PPO never acts: in this limit the proximal loss is REINFORCE (Williams 1992).
    """

    policy: BlockPolicyGradient = BlockPolicyGradient()  # noqa: RUF009  (frozen)

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The policy's loss over its `draws` actions."""
        mean, corner = problem.act(), self.policy.draw_corner(generator)
        actions = self.policy.antithetic_actions(mean, corner, generator)
        rollout = problem.rollout(actions)
        batch = RolloutBatch(
            actions, rollout.errors, rollout.counts, corner, problem.multiplicative
        )
        return self.policy.loss(mean, batch)


def budget_coupling(usual: Tensor, multiplicative: bool) -> tuple[Tensor, Tensor]:
    """Weights for the price, and the direction of actions that the budget cancels.

    `usual` are the mean counts n. All pixels give up samples in proportion to n, so the
    price is the mean slope of error against count, weighted by n. An observed slope is already
    weighted by the square of the change of count, which is uniform if actions add to the density
    and grows as n if they multiply it. The budget cancels a common factor on every density: a
    change of actions as n if they add, uniform if they multiply.
    """
    if multiplicative:
        return 1 / usual.clamp_min(MIN_COUNT), torch.ones_like(usual)
    return usual, usual


def advantage(
    error: Tensor,
    count: Tensor,
    weight: Tensor,
    image: tuple[int, ...],
    price_weight: float,
    clip: float,
) -> Tensor:
    """-(change of error + price * change of count), in standard deviations, clipped.

    `error` and `count` are deviations from the baseline. `image` are the dimensions that share a
    budget; their price is the weighted least-squares slope of error against count.
    """
    slope = (weight * error * count).sum(image, keepdim=True)
    price = -slope / (weight * count.square()).sum(image, keepdim=True).clamp_min(TINY)
    gain = -(error + price_weight * price * count)
    size = gain.square().mean(image, keepdim=True).sqrt().clamp_min(TINY)
    return (gain / size).clamp(-clip, clip)


def remove_common_change(moved: Tensor, common: Tensor, image: tuple[int, ...]) -> Tensor:
    """A change of actions without its component along `common`, which the budget cancels."""
    unit = common / common.square().sum(image, keepdim=True).sqrt().clamp_min(TINY)
    return moved - unit * (moved * unit).sum(image, keepdim=True)
