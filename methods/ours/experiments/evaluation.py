"""Judging a sampler on scenes that no training saw: its share of the optimal reduction of error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from methods.ours.experiments.known_optimum import Mode, ToyProblem, greedy
from methods.ours.experiments.toy_scenes import CHANNELS, STORED, ToyFrame, scenes
from methods.ours.policy.environment import StepResult
from rlbench.sampling import allocate_counts
from rlbench.training.surrogate_gradient import relaxed_counts

UNSEEN = 10**6  # seed of the scenes that are judged on
APART = 7  # frames between two that are judged
STEPS, RATE = 100, 0.1  # of the descent to the best counts where none are known in closed form
FAINT = 0.02  # log density of the least noisy pixels where the descent starts from deviations


@dataclass(frozen=True)
class Evaluation:
    """Frames, their expected errors under uniform sampling, and under the best counts known."""

    mode: Mode
    fields: tuple[ToyFrame, ...]
    uniform: tuple[Float[Tensor, " n"], ...]  # mean error of each image
    best: tuple[Float[Tensor, " n"], ...]

    @classmethod
    def of(cls, mode: Mode, frames: int = 1, n: int = 8, side: int = 48) -> Evaluation:
        """So many frames of n scenes each."""
        stream = scenes(UNSEEN, n, side)
        fields = [field for at, field in zip(range(frames * APART), stream, strict=False)]
        fields = fields[::APART]
        moments = [_moment(field, mode) for field in fields]
        uniform = [m.expected(torch.full_like(m.field.sigma, m.spp)) for m in moments]
        best = [m.expected(best_counts(m).float()) for m in moments]
        images = [tuple(each.mean((1, 2, 3)) for each in maps) for maps in (uniform, best)]
        return cls(mode, tuple(fields), *images)

    @property
    def side(self) -> int:
        """Rows and columns of a frame."""
        return self.fields[0].sigma.shape[-1]

    @torch.no_grad()
    def score(self, sampler: Callable[[Tensor], Tensor], floor: int = 0) -> float:
        """(error of uniform - error of the map) / (error of uniform - least error), mean of images.

        0 for uniform sampling, 1 for the best counts known, below 0 for worse than uniform. Errors
        are expectations, so that no noise of samples is in it.
        """
        reached = []
        for field, uniform, best in zip(self.fields, self.uniform, self.best, strict=True):
            moment = ToyProblem(field, self.mode, sampler, floor=floor)
            error = moment.expected(moment.buy(moment.act()).float()).mean((1, 2, 3))
            reached.append((uniform - error) / (uniform - best))
        return float(torch.cat(reached).mean())


def best_counts(moment: ToyProblem) -> Int[Tensor, "n 1 h w"]:
    """The best whole counts: exact where pixels are independent, else the best that were found.

    The error of coupled pixels has many minima. A density for each pixel descends on the exact
    expected error, from uniform and from a start that follows deviations; the better one of each
    image counts. So scores are shares of what is known to be possible, and a score above 1 would be
    news.
    """
    sigma = moment.field.sigma
    if moment.mode.reach == 0:
        return greedy(sigma, moment.cost)
    starts = (torch.zeros_like(sigma), (sigma / sigma.amax((2, 3), keepdim=True)).clamp_min(FAINT))
    first, second = _descend(moment, starts[0]), _descend(moment, starts[1].log())
    errors = [moment.expected(n.float()).mean((1, 2, 3), keepdim=True) for n in (first, second)]
    return torch.where(errors[0] <= errors[1], first, second)


def _descend(moment: ToyProblem, start: Tensor) -> Tensor:
    free = start.clone().requires_grad_()
    nothing = torch.zeros(start.shape, dtype=torch.int64)
    optimizer = torch.optim.Adam([free], RATE)
    for _ in range(STEPS):
        density = (free - free.detach().amax((2, 3), keepdim=True)).exp()
        due = relaxed_counts(density, moment.spp, nothing, STORED)
        optimizer.zero_grad()
        moment.expected(due).mean().backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    return allocate_counts(density.detach(), moment.cost, nothing, STORED, moment.field.keys)


def _moment(field: ToyFrame, mode: Mode) -> ToyProblem:
    return ToyProblem(field, mode, lambda seen: torch.zeros_like(seen[:, :1]))


class Scenes:
    """The task as a world of reinforcement learning: one scene at a time, episodes of 20 frames."""

    def __init__(self, mode: Mode, seed: int, side: int = 48) -> None:
        """From the scenes of a seed."""
        self.mode, self.shape = mode, (CHANNELS, side, side)
        self._stream = scenes(seed, 1, side)
        self._field = next(self._stream)

    def reset(self) -> Float[Tensor, "1 c h w"]:
        """The first frame of the next episode, which a step to the last has already drawn."""
        while self._field.index:
            self._field = next(self._stream)
        return self._field.seen

    def step(self, action: Float[Tensor, "1 1 h w"]) -> StepResult:
        """Realised errors of the frame's image, and the next frame."""
        trial = _moment(self._field, self.mode).rollout(action.unsqueeze(0))
        last, self._field = self._field, next(self._stream)
        over = self._field.index == 0
        seen = last.seen if over else self._field.seen
        return StepResult(trial.errors[0], trial.counts[0], seen, over)
