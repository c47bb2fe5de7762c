"""Scores of samplers on unseen toy scenes, and the table of all trainings' scores."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from methods.ours.gradients.toy_problem import (
    CHANNELS,
    STORED_SAMPLES,
    Mode,
    ToyFrame,
    ToyProblem,
    greedy_counts,
    toy_frames,
)
from methods.ours.policy import StepResult
from rlbench.sampling import allocate_counts
from rlbench.system import paths
from rlbench.training.surrogate_gradient import relaxed_counts

TEST_SEED = 10**6  # of the scenes that samplers are scored on
FRAME_STRIDE = 7  # frames from one scored frame to the next
DESCENT_STEPS, DESCENT_RATE = 100, 0.1  # of Adam, where no optimum is known in closed form
MIN_START = 0.02  # least density, as a share of the largest, where the descent starts from sigma
TABLE = "known_optimum.csv"

Row = Mapping[str, str]


@dataclass(frozen=True)
class Evaluation:
    """Frames with their expected errors under uniform sampling and under the best known counts."""

    mode: Mode
    frames: tuple[ToyFrame, ...]
    uniform: tuple[Float[Tensor, " n"], ...]  # mean error of each image
    best: tuple[Float[Tensor, " n"], ...]

    @classmethod
    def of_mode(cls, mode: Mode, frames: int = 1, n: int = 8, side: int = 48) -> Evaluation:
        """An evaluation on `frames` frames of n scenes each."""
        stream = toy_frames(TEST_SEED, n, side)
        chosen = [frame for _, frame in zip(range(frames * FRAME_STRIDE), stream, strict=False)]
        chosen = chosen[::FRAME_STRIDE]
        problems = [_uniform_problem(frame, mode) for frame in chosen]
        uniform = [p.expected_error(torch.full_like(p.frame.sigma, p.spp)) for p in problems]
        best = [p.expected_error(best_counts(p).float()) for p in problems]
        means = [tuple(error.mean((1, 2, 3)) for error in maps) for maps in (uniform, best)]
        return cls(mode, tuple(chosen), *means)

    @property
    def side(self) -> int:
        """Rows and columns of a frame."""
        return self.frames[0].sigma.shape[-1]

    @torch.no_grad()
    def score(self, sampler: Callable[[Tensor], Tensor], min_samples: int = 0) -> float:
        """(error of uniform - error of the map) / (error of uniform - least error), mean of images.

        0 for uniform sampling, 1 for the best known counts, below 0 for worse than uniform. Errors
        are expectations, so the score has no sampling noise.
        """
        scores = []
        for frame, uniform, best in zip(self.frames, self.uniform, self.best, strict=True):
            problem = ToyProblem(frame, self.mode, sampler, min_samples=min_samples)
            counts = problem.draw_counts(problem.act())
            error = problem.expected_error(counts.float()).mean((1, 2, 3))
            scores.append((uniform - error) / (uniform - best))
        return float(torch.cat(scores).mean())


def best_counts(problem: ToyProblem) -> Int[Tensor, "n 1 h w"]:
    """The best known whole counts: exact where pixels are independent, else by descent.

    The error of coupled pixels has many minima. A density for each pixel descends on the exact
    expected error, from a uniform start and from one that follows the deviations; the better result
    of each image counts. Scores are therefore shares of what is known to be possible, and a score
    above 1 can occur.
    """
    sigma = problem.frame.sigma
    if problem.mode.reach == 0:
        return greedy_counts(sigma, problem.total_samples)
    relative = (sigma / sigma.amax((2, 3), keepdim=True)).clamp_min(MIN_START)
    first, second = (_descend(problem, s) for s in (torch.zeros_like(sigma), relative.log()))
    errors = [
        problem.expected_error(n.float()).mean((1, 2, 3), keepdim=True) for n in (first, second)
    ]
    return torch.where(errors[0] <= errors[1], first, second)


def _descend(problem: ToyProblem, start: Tensor) -> Tensor:
    """Whole counts after DESCENT_STEPS of Adam on log densities from `start`."""
    log_density = start.clone().requires_grad_()
    none = torch.zeros(start.shape, dtype=torch.int64)
    optimizer = torch.optim.Adam([log_density], DESCENT_RATE)
    for _ in range(DESCENT_STEPS):
        density = (log_density - log_density.detach().amax((2, 3), keepdim=True)).exp()
        counts = relaxed_counts(density, problem.spp, none, STORED_SAMPLES)
        optimizer.zero_grad()
        problem.expected_error(counts).mean().backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    seeds = problem.frame.rounding_seeds
    return allocate_counts(density.detach(), problem.total_samples, none, STORED_SAMPLES, seeds)


def _uniform_problem(frame: ToyFrame, mode: Mode) -> ToyProblem:
    return ToyProblem(frame, mode, lambda observation: torch.zeros_like(observation[:, :1]))


class ToyEnv:
    """The toy problem as an `Env`: one scene at a time, episodes of 20 frames."""

    def __init__(self, mode: Mode, seed: int, side: int = 48) -> None:
        """An environment on the scenes of a seed."""
        self.mode, self.shape = mode, (CHANNELS, side, side)
        self._stream = toy_frames(seed, 1, side)
        self._frame = next(self._stream)

    def reset(self) -> Float[Tensor, "1 c h w"]:
        """Start the next episode; a step to the last frame has already drawn its first frame."""
        while self._frame.index:
            self._frame = next(self._stream)
        return self._frame.observation

    def step(self, action: Float[Tensor, "1 1 h w"]) -> StepResult:
        """Realised errors of the frame's image, and the next observation."""
        rollout = _uniform_problem(self._frame, self.mode).rollout(action.unsqueeze(0))
        last, self._frame = self._frame, next(self._stream)
        truncated = self._frame.index == 0
        observation = last.observation if truncated else self._frame.observation
        return StepResult(rollout.errors[0], rollout.counts[0], observation, truncated)


class Training(NamedTuple):
    """The identity of one training."""

    learner: str
    mode: str
    seed: int

    def __str__(self) -> str:
        """For the progress bar."""
        return f"{self.learner}, {self.mode}, seed {self.seed}"


def read_scores(file: Path, frames: int, side: int) -> dict[Training, list[Row]]:
    """The rows of each training in a table; empty if there is no file.

    Raises ValueError if it has trainings of another length, or on frames of another size.
    """
    scores: dict[Training, list[Row]] = {}
    rows = list(csv.DictReader(file.read_text().splitlines())) if file.exists() else []
    if other := {(row["side"], row["of"]) for row in rows} - {(str(side), str(frames))}:
        found = " and ".join(f"--frames {of} --side {pixels}" for pixels, of in sorted(other))
        raise ValueError(
            f"--frames {frames} --side {side}: {file} has trainings by {found}, which cannot be "
            "compared with these. Choose another --out"
        )
    for row in rows:
        training = Training(row["learner"], row["mode"], int(row["seed"]))
        scores.setdefault(training, []).append(row)
    return scores


def write_csv(file: Path, rows: Sequence[Row]) -> None:
    """Replace a file by a table with the keys of the first row as its header."""
    with paths.atomic_write(file) as part, part.open("w", newline="") as out:
        writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
