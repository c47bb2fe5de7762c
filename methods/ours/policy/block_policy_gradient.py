"""The policy gradient of the sampler: blocks of pixels, local credit, a price on samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

TINY = 1e-8  # keeps what nothing differs in from dividing by zero
FEW = 0.1  # samples: fewer than these weigh no more


class RolloutBatch(NamedTuple):
    """What was tried `k` times from the state of one frame, on one grid of blocks."""

    actions: Float[Tensor, "k n 1 h w"]  # drawn around the mean
    errors: Float[Tensor, "k n 1 h w"]  # of each pixel of the image that came of it
    counts: Float[Tensor, "k n 1 h w"]  # samples bought
    corner: tuple[int, int]  # row and column of the first whole block
    multiplicative: bool = False  # does the density grow by factors with the action, or by steps?


@dataclass(frozen=True)
class BlockPolicyGradient:
    """REINFORCE, block by block.

    A denoiser spreads every sample over its neighbours, so that one pixel's noise tells nothing of
    one pixel's worth: actions are drawn for whole blocks, on a grid that is shifted each frame. The
    baseline is the mean of mirrored draws of the same frame and state. Budget couples the blocks: a
    sample more here is one fewer elsewhere, hence a price on samples, and the advantage of a block
    is -(change of error in and around it + price * change of its count), the price being the
    least-squares slope of error against count. The paper gives one reward a frame to an APPO
    learner, whose joint ratio over all pixels leaves the clip range after one step.
    """

    action_std: float = 0.3  # deviation of the action, whose range is [-1, 1]
    draws: int = 4  # of the same frame and state, an even number
    block: int = 8  # pixels: side of a block
    margin: int = 4  # pixels around a block whose error is credited to it
    price_weight: float = 1.0  # share of the price that is charged; 0 shows what it is for
    advantage_clip: float = 3.0  # deviations that an advantage is cut at

    def corner(self, generator: torch.Generator) -> tuple[int, int]:
        """A grid of blocks: row and column of its first whole block."""
        row, column = torch.randint(self.block, (2,), generator=generator).tolist()
        return row, column

    def explore(
        self,
        mean: Float[Tensor, "n 1 h w"],
        corner: tuple[int, int],
        generator: torch.Generator,
    ) -> Float[Tensor, "n 1 h w"]:
        """An action drawn around the mean, with the same noise all over a block."""
        n, _, h, w = mean.shape
        rows, columns = (1 + (side + self.block - 1) // self.block for side in (h, w))
        noise = torch.randn((n, 1, rows, columns), generator=generator).to(mean.device)
        noise = noise.repeat_interleave(self.block, 2).repeat_interleave(self.block, 3)
        top, left = (-at % self.block for at in corner)
        return mean.detach() + self.action_std * noise[..., top : top + h, left : left + w]

    def antithetic_actions(
        self,
        mean: Float[Tensor, "n 1 h w"],
        corner: tuple[int, int],
        generator: torch.Generator,
    ) -> Float[Tensor, "k n 1 h w"]:
        """Actions around the mean, in mirrored pairs: what one adds the other takes away."""
        halves = [self.explore(mean, corner, generator) for _ in range(self.draws // 2)]
        return torch.stack([*halves, *(2 * mean.detach() - half for half in halves)])

    def loss(self, mean: Float[Tensor, "n 1 h w"], drawn: RolloutBatch) -> Float[Tensor, ""]:
        """Minus the mean over whole blocks of advantage times log-probability of their actions.

        As the actions are those that were just drawn, the ratio of the proximal loss is 1, and its
        clipping has nothing to do. The budget cancels what all actions of an image share: that is
        taken out of the gradient, and the square of their mean is added, for it would still drift
        to where tanh is flat.
        """
        worse = self._blocks(drawn.errors - drawn.errors.mean(0), drawn.corner, self.margin)
        more = self._blocks(drawn.counts - drawn.counts.mean(0), drawn.corner)
        usual = self._blocks(drawn.counts.mean(0, keepdim=True), drawn.corner)
        image = (0, 2, 3, 4)  # each has a price of its own
        weight, shared = coupling(usual, drawn.multiplicative)
        gain = advantage(worse, more, weight, image, self.price_weight, self.advantage_clip)
        away = self._blocks(drawn.actions - mean.detach(), drawn.corner)
        moved = self._blocks((mean - mean.detach()).unsqueeze(0), drawn.corner)  # zero
        if self.price_weight:
            moved = own(moved, shared, image)
        away = (away - moved) / self.block**2 / self.action_std
        drift = mean.mean((1, 2, 3)).square().mean()
        return (gain * away.square()).mean() / 2 + drift

    def _blocks(
        self, values: Float[Tensor, "k n 1 h w"], corner: tuple[int, int], margin: int = 0
    ) -> Float[Tensor, "k n 1 _ _"]:
        """Sums over the whole blocks of a grid, each with `margin` pixels around it."""
        up, left = (min(margin, at) for at in corner)  # what there is of it before the first block
        inside = values[..., corner[0] - up :, corner[1] - left :]
        side = self.block + 2 * margin
        padded = F.pad(inside.flatten(0, 1), (margin - left, margin, margin - up, margin))
        sums = F.avg_pool2d(padded, side, self.block) * side**2
        return sums.view(*inside.shape[:3], *sums.shape[-2:])


def coupling(usual: Tensor, factors: bool) -> tuple[Tensor, Tensor]:
    """Weights of the price, and the change of actions that the budget cancels.

    From the usual counts n. A sample more for one is paid for by all in proportion to what they
    have, so that the price is the mean slope of error against count, weighted by n. What is seen of
    a slope is weighted already, by the square of the change of count, which is alike for all where
    the density grows by steps, and as n where it grows by factors. What the budget cancels is a
    factor on every density: a change of actions as n by steps, alike for all by factors.
    """
    if factors:
        return 1 / usual.clamp_min(FEW), torch.ones_like(usual)
    return usual, usual


def advantage(
    worse: Tensor, more: Tensor, weight: Tensor, image: tuple[int, ...], priced: float, most: float
) -> Tensor:
    """-(change of error + price * change of count), in deviations of an image, cut at `most`.

    `image` are the dimensions that share a budget. Their price is the weighted least-squares slope
    of error against count.
    """
    slope = (weight * worse * more).sum(image, keepdim=True)
    price = -slope / (weight * more.square()).sum(image, keepdim=True).clamp_min(TINY)
    gain = -(worse + priced * price * more)
    size = gain.square().mean(image, keepdim=True).sqrt().clamp_min(TINY)
    return (gain / size).clamp(-most, most)


def own(moved: Tensor, shared: Tensor, image: tuple[int, ...]) -> Tensor:
    """A change of actions, less what all share of it: a factor on every density, thus on none."""
    unit = shared / shared.square().sum(image, keepdim=True).sqrt().clamp_min(TINY)
    return moved - unit * (moved * unit).sum(image, keepdim=True)
