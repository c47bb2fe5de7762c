"""Frames and episodes as problems: the sampler of `ours` acts, its denoiser answers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from methods.ours.history import RecurrentState
from methods.ours.method import Ours
from methods.ours.policy import Rollout, StepResult
from rlbench.frames import Frame, GBuffer, Pool, Samples
from rlbench.ops.losses import log_transfer_loss
from rlbench.ops.reprojection import reproject
from rlbench.ops.transfer import log_forward
from rlbench.sampling import draw_samples
from rlbench.sanitize import SanitizedPool, sanitize_frame
from rlbench.training.batches import Batches, sample_budget
from rlbench.training.surrogate_gradient import SampleGradient, relaxed_counts

HIGHEST_REWARD = 10.0


class FrameStep(NamedTuple):
    """The result of one action."""

    errors: Float[Tensor, "n 1 h w"]  # squared error in log transfer, mean over colours
    counts: Float[Tensor, "n 1 h w"]  # samples drawn
    state: RecurrentState  # for the next frame


@dataclass(frozen=True)
class FrameProblem:
    """An AllocationProblem (`policy/learner.py`) made of a frame, a state and a budget."""

    method: Ours
    frame: Frame
    gbuffer: GBuffer  # the inputs that the method declares
    state: RecurrentState
    spp: float

    @classmethod
    def of_frame(
        cls, method: Ours, frame: Frame, state: RecurrentState, spp: float
    ) -> FrameProblem:
        """The problem of a frame, with the inputs that the method declares, sanitised."""
        gbuffer = sanitize_frame(frame, method.traits.inputs).gbuffer
        return cls(method, frame, gbuffer, state, spp)

    @property
    def min_samples(self) -> int:
        """Fewest samples of a pixel."""
        return self.method.traits.min_samples

    @property
    def max_samples(self) -> int:
        """Most samples of a pixel: a limit of the method, or what the pool holds."""
        limit, stored = self.method.traits.max_samples, self.frame.pool.max_samples
        return stored if limit is None else min(limit, stored)

    @property
    def multiplicative(self) -> bool:
        """True if a step of the action multiplies the density by a factor; else it adds to it."""
        return self.method.config.density == "exponential"

    @property
    def observation(self) -> Float[Tensor, "n c h w"]:
        """The sampler's inputs, without gradient."""
        with torch.no_grad():
            return self.method.reproject(self.gbuffer, self.state).sampler_inputs

    def act(self) -> Float[Tensor, "n 1 h w"]:
        """The sampler's mean action."""
        return self.method.act(self.gbuffer, self.state)

    def relaxed_counts(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        """Samples per pixel before rounding."""
        density = self._density(action)
        highest = density.detach().amax((2, 3), keepdim=True)
        relative = torch.where(highest > 0, density / highest.where(highest > 0, 1.0), 1.0)
        low = torch.full_like(density, self.min_samples)
        return relaxed_counts(relative, self.spp, low, self.max_samples)

    def draw_counts(self, action: Float[Tensor, "n 1 h w"]) -> Int[Tensor, "n 1 h w"]:
        """Relaxed counts rounded at random, at the exact budget."""
        return self._draw_samples(action).counts

    @torch.no_grad()
    def evaluate_counts(self, counts: Int[Tensor, "k n 1 h w"]) -> Float[Tensor, "k n 1 h w"]:
        """Squared errors in log transfer of k sets of counts."""
        samples = (Samples(self._pool.read(self._pool.empty(), each), each) for each in counts)
        return torch.stack([self._denoise(each).errors for each in samples])

    @torch.no_grad()
    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Squared errors in log transfer, and counts, of k actions."""
        steps = [self.step(action) for action in actions]
        return Rollout(
            torch.stack([step.errors for step in steps]),
            torch.stack([step.counts for step in steps]),
        )

    @torch.no_grad()
    def step(self, action: Float[Tensor, "n 1 h w"]) -> FrameStep:
        """Draw samples by an action, denoise them, and compare the image with the reference."""
        return self._denoise(self._draw_samples(action))

    def _denoise(self, samples: Samples) -> FrameStep:
        image, state = self.method.denoise(self.gbuffer, samples, self.state)
        error = (log_forward(image).clamp(0, 1) - self._truth).square().mean(1, keepdim=True)
        return FrameStep(error, samples.counts.float(), state)

    @torch.no_grad()
    def render(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 3 h w"]:
        """The denoised image of an action, linear radiance."""
        samples = self._draw_samples(action)
        return self.method.denoise(self.gbuffer, samples, self.state)[0]

    def surrogate_loss(self, sample_gradient: SampleGradient) -> Float[Tensor, ""]:
        """The loss of the mean action's image, with a gradient to the action through the samples.

        The gradient reaches the sampler alone. Encoder and denoiser learn from the training image.
        """
        action = self.act()
        samples = sample_gradient(
            self._draw_samples(action.detach()), self.relaxed_counts(action), self.frame
        )
        with freeze(self.method.networks.encoder, self.method.networks.denoiser):
            image, _ = self.method.denoise(self.gbuffer, samples, self.state)
        return log_transfer_loss(image, self.frame.reference.mean)

    @cached_property
    def _truth(self) -> Float[Tensor, "n 3 h w"]:
        return log_forward(self.frame.reference.mean).clamp(0, 1)

    @cached_property
    def _pool(self) -> Pool:
        return SanitizedPool(self.frame.pool)

    def _draw_samples(self, action: Float[Tensor, "n 1 h w"]) -> Samples:
        pool, density = self._pool, self._density(action)
        return draw_samples(
            pool, pool.empty(), density, self.spp, self.min_samples, self.max_samples
        )

    def _density(self, action: Float[Tensor, "n 1 h w"]) -> Float[Tensor, "n 1 h w"]:
        return self.method.to_density(action, self.gbuffer, self.state)


@dataclass(frozen=True)
class EpisodeProblem(FrameProblem):
    """A FrameProblem whose rollouts end with the episode.

    After an action, the sampler goes on with its mean actions. The result of a pixel is its
    discounted return, which follows the motion (`discounted_return`).
    """

    later: Sequence[Frame] = ()  # frames of the episode after this one
    gamma: float = 0.0  # discount per frame

    @classmethod
    def of_problem(
        cls, problem: FrameProblem, later: Sequence[Frame], gamma: float
    ) -> EpisodeProblem:
        """The problem of a frame that later frames follow."""
        parts = (problem.method, problem.frame, problem.gbuffer, problem.state, problem.spp)
        return cls(*parts, later, gamma)

    @torch.no_grad()
    def rollout(self, actions: Float[Tensor, "k n 1 h w"]) -> Rollout:
        """Counts of k actions in this frame, and what their returns lack to the highest."""
        steps = [self.step(action) for action in actions]
        counts = torch.stack([step.counts for step in steps])
        costs, motions = [_cost(steps)], []
        for frame in self.later:
            following = FrameProblem.of_frame(self.method, frame, steps[0].state, self.spp)
            problems = [replace(following, state=step.state) for step in steps]
            steps = [problem.step(problem.act()) for problem in problems]
            costs.append(_cost(steps))
            motions.append(following.gbuffer.motion)
        return Rollout(discounted_return(costs, motions, self.gamma), counts)


class SamplingEnv:
    """An `Env` (`policy/learner.py`) around the other networks of `ours`.

    An episode is a sequence of crops from one clip, at a budget drawn for the episode. `problem` is
    the frame in which the sampler acts next.
    """

    problem: FrameProblem

    def __init__(self, method: Ours, batches: Batches, budgets: Sequence[float]) -> None:
        """Episodes are the draws of `batches`, of one clip each; `budgets` in spp."""
        self.method, self.batches, self.budgets = method, batches, tuple(budgets)
        self.shape = (method.networks.sampler_channels, batches.crop, batches.crop)
        self._draw = 0

    def reset(self) -> Float[Tensor, "1 c h w"]:
        """Start the next episode; returns the observation of its first frame."""
        clip = self.batches.sequence(self._draw)
        self._spp = sample_budget(self.budgets, self.batches.seed, self._draw)
        self._draw += 1
        self._frames = iter(clip)
        self._enter(next(self._frames), self.method.start(clip.size))
        return self.problem.observation

    @torch.no_grad()
    def step(self, action: Float[Tensor, "1 1 h w"]) -> StepResult:
        """Draw samples by an action, denoise, and enter the next frame."""
        errors, counts, state = self.problem.step(action)
        frame = next(self._frames, None)
        if frame is not None:
            self._enter(frame, state)
        return StepResult(errors, counts, self.problem.observation, frame is None)

    def _enter(self, frame: Frame, state: RecurrentState) -> None:
        self.problem = FrameProblem.of_frame(self.method, frame, state, self._spp)


def reward(error: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """10^(1 - error), the paper's reward of a loss; 10 without error, at least 1 up to an error 1.

    >>> reward(torch.tensor([0.0, 1.0]))
    tensor([10.,  1.])
    """
    return HIGHEST_REWARD ** (1 - error)


def discounted_return(
    rewards: Sequence[Float[Tensor, "k n 1 h w"]],
    motions: Sequence[Float[Tensor, "n 2 h w"] | None],
    gamma: float,
) -> Float[Tensor, "k n 1 h w"]:
    """Rewards of consecutive frames, at the pixels of the first: r0 + gamma (r1 + gamma (...)).

    `motions` are those of the second and later frames, to the frame before, in pixels. A later
    reward counts where the history of its pixel came from (`carry_back`), because a sample is
    worth something later at the place to which its surface has moved.

    >>> frames = [torch.full((1, 1, 1, 2, 2), r) for r in (1.0, 2.0, 4.0)]
    >>> float(discounted_return(frames, [None, None], gamma=0.5).mean())  # 1 + 2 / 2 + 4 / 4
    3.0
    """
    total = rewards[-1]
    for earlier, motion in zip(rewards[-2::-1], motions[::-1], strict=True):
        total = earlier + gamma * carry_back(total, motion)
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


@contextmanager
def freeze(*modules: nn.Module | None) -> Iterator[None]:
    """Within this context no gradient reaches the modules' weights; it passes through to inputs."""
    trainable = [w for m in modules if m is not None for w in m.parameters() if w.requires_grad]
    for weight in trainable:
        weight.requires_grad_(False)
    try:
        yield
    finally:
        for weight in trainable:
            weight.requires_grad_(True)


def _cost(steps: Sequence[FrameStep]) -> Float[Tensor, "k n 1 h w"]:
    """The highest reward less the reward of each pixel, >= 0."""
    return HIGHEST_REWARD - reward(torch.stack([step.errors for step in steps]))
