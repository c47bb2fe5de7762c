"""REINFORCE on blocks of pixels, with local credit and a price on samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from methods.ours.policy.learner import AllocationProblem, SamplerLearner

TINY = 1e-8  # avoids a division by zero where all actions have equal results
MIN_COUNT = 0.1  # samples; smaller usual counts are weighted as this

Corner = Int[Tensor, "2"] | tuple[int, int]  # a tensor where a recorded step draws it anew


class RolloutBatch(NamedTuple):
    """Actions from the state of one frame, on one grid of blocks, and their results."""

    actions: Float[Tensor, "k n 1 h w"]  # drawn around the mean
    errors: Float[Tensor, "k n 1 h w"]  # of each pixel of the image
    counts: Float[Tensor, "k n 1 h w"]  # samples drawn
    corner: Corner  # row and column of the first whole block
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

    def draw_corner(self, generator: torch.Generator) -> Int[Tensor, "2"]:
        """A random grid of blocks: row and column of its first whole block."""
        return torch.randint(self.block, (2,), generator=generator, device=generator.device)

    def explore(
        self, mean: Float[Tensor, "n 1 h w"], corner: Corner, generator: torch.Generator
    ) -> Float[Tensor, "n 1 h w"]:
        """An action drawn around the mean, with constant noise within a block."""
        n, _, h, w = mean.shape
        rows, columns = (1 + (side + self.block - 1) // self.block for side in (h, w))
        shape = (n, 1, rows, columns)
        noise = torch.randn(shape, generator=generator, device=generator.device).to(mean.device)
        for dim, side, first in zip((2, 3), (h, w), corner, strict=True):
            pixels = torch.arange(side, device=mean.device) + -first % self.block
            noise = noise.index_select(dim, pixels // self.block)
        return mean.detach() + self.action_std * noise

    def antithetic_actions(
        self, mean: Float[Tensor, "n 1 h w"], corner: Corner, generator: torch.Generator
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
        is_whole = self.find_whole(mean, batch.corner)
        share = is_whole.float().mean().clamp_min(TINY)  # other blocks count as 0 in each mean
        image = (0, 2, 3, 4)  # each image has a price of its own
        weight, common = budget_coupling(usual, batch.multiplicative)
        gain = advantage(error, count, weight, image, self.price_weight, self.advantage_clip, share)
        noise = self._block_sums(batch.actions - mean.detach(), batch.corner)
        moved = self._block_sums((mean - mean.detach()).unsqueeze(0), batch.corner)  # zero
        if self.price_weight:
            moved = remove_common_change(moved, common * is_whole, image)
        distance = (noise - moved) / self.block**2 / self.action_std
        drift = mean.mean((1, 2, 3)).square().mean()
        return (gain * distance.square()).mean() / share / 2 + drift

    def find_whole(
        self, image: Float[Tensor, "*n h w"], corner: Corner
    ) -> Bool[Tensor, "rows columns"]:
        """True for the blocks from `corner` on that lie inside an image of this shape."""
        down, right = (
            first + self.block * torch.arange(1, count + 1, device=image.device) <= side
            for first, side, count in zip(
                corner, image.shape[-2:], self._count_blocks(image), strict=True
            )
        )
        is_whole: Tensor = down[:, None] & right
        return is_whole

    def _count_blocks(self, image: Tensor) -> list[int]:
        """Rows and columns of a grid: equally many for every corner, so that shapes are fixed."""
        return [max(1, side // self.block) for side in image.shape[-2:]]

    def _block_sums(
        self, values: Float[Tensor, "k n 1 h w"], corner: Corner, margin: int = 0
    ) -> Float[Tensor, "k n 1 rows columns"]:
        """Sums over the whole blocks of a grid, each with `margin` pixels around it; else 0."""
        is_whole, inside = self.find_whole(values, corner), values
        for dim, first, count in zip((-2, -1), corner, self._count_blocks(values), strict=True):
            pixels = torch.arange(-margin, count * self.block + margin, device=values.device)
            pixels = pixels + first
            last = values.shape[dim] - 1
            is_pixel = ((pixels >= 0) & (pixels <= last)).unflatten(0, (-1, *[1] * (-1 - dim)))
            inside = inside.index_select(dim, pixels.clamp(0, last)).where(is_pixel, 0.0)
        side = self.block + 2 * margin
        sums = F.avg_pool2d(inside.flatten(0, 1), side, self.block) * side**2
        return sums.view(*inside.shape[:3], *sums.shape[-2:]) * is_whole


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
    share: Tensor | float = 1.0,
) -> Tensor:
    """-(change of error + price * change of count), in standard deviations, clipped.

    The standard deviation is that over the `share` of the values that count; the others are 0.

    `error` and `count` are deviations from the baseline. `image` are the dimensions that share a
    budget; their price is the weighted least-squares slope of error against count.
    """
    slope = (weight * error * count).sum(image, keepdim=True)
    price = -slope / (weight * count.square()).sum(image, keepdim=True).clamp_min(TINY)
    gain = -(error + price_weight * price * count)
    size = (gain.square().mean(image, keepdim=True) / share).sqrt().clamp_min(TINY)
    return (gain / size).clamp(-clip, clip)


def remove_common_change(moved: Tensor, common: Tensor, image: tuple[int, ...]) -> Tensor:
    """A change of actions without its component along `common`, which the budget cancels."""
    unit = common / common.square().sum(image, keepdim=True).sqrt().clamp_min(TINY)
    return moved - unit * (moved * unit).sum(image, keepdim=True)
