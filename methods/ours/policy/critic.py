"""The critic: a network that predicts the error map from counts, and the gradient through it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn import functional as F

from methods.ours.policy.learner import AllocationProblem, SamplerLearner
from methods.ours.policy.reinforce import BlockPolicyGradient
from rlbench.ops.init import kaiming_init

EPS = 1e-8  # squared error; keeps the scale of errors above zero
ERROR_CLIP = 30.0  # times the mean error, so that no firefly dominates the regression


class Transition(NamedTuple):
    """One action's results."""

    observation: Float[Tensor, "n c h w"]
    counts: Float[Tensor, "n 1 h w"]
    errors: Float[Tensor, "n 1 h w"]


class ReplayBuffer(nn.Module):
    """Past transitions and the scale of their errors.

    A part of the critic's network, so that it is saved in checkpoints, and a resumed training is
    the same as an uninterrupted one.
    """

    scale: Float[Tensor, ""]  # running mean of a pixel's error; 0 before the first

    def __init__(self, capacity: int) -> None:
        """A buffer of `capacity` transitions."""
        super().__init__()
        self.register_buffer("scale", torch.zeros(()))
        self.past: deque[Transition] = deque(maxlen=capacity)

    def update_scale(self, error: Float[Tensor, ""]) -> None:
        """Move the scale towards a mean error."""
        self.scale.copy_(error if self.scale == 0 else 0.98 * self.scale + 0.02 * error)

    def sample(self, number: int, generator: torch.Generator) -> list[Transition]:
        """`number` random transitions, or none while there are fewer."""
        if len(self.past) < number:
            return []
        chosen = torch.randperm(len(self.past), generator=generator)[:number]
        return [self.past[i] for i in chosen.tolist()]

    def get_extra_state(self) -> Tensor:
        """All transitions as one tensor [k n c+2 h w], empty without any."""
        rows = [torch.cat(transition, 1) for transition in self.past]
        return torch.stack(rows) if rows else torch.zeros(0)

    def set_extra_state(self, state: Tensor) -> None:
        """Restore the transitions from `get_extra_state`."""
        self.past.clear()
        for row in state.to(self.scale.device):
            self.past.append(Transition(row[:, :-2], row[:, -2:-1], row[:, -1:]))


class ErrorMap(nn.Module):
    """Predicts each pixel's error from the sampler's observation and the counts around the pixel.

    A 3x3 convolution reads the observation, which says how noisy a pixel is. Counts n join as
    1 / (n + 1/2), in which the error of a mean is linear; three more convolutions follow.
    """

    def __init__(self, channels: int, width: int = 16, capacity: int = 32) -> None:
        """Build for observations of `channels`, with a replay buffer of `capacity`."""
        super().__init__()
        self.replay = ReplayBuffer(capacity)
        self.see = nn.Conv2d(channels, width, 3, padding=1)
        self.buy = nn.Conv2d(width + 2, width, 3, padding=1)
        self.mix = nn.Conv2d(width, width, 3, padding=1)
        self.tell = nn.Conv2d(width, 1, 3, padding=1)

    def forward(
        self, observation: Float[Tensor, "n c h w"], counts: Float[Tensor, "n 1 h w"]
    ) -> Float[Tensor, "n 1 h w"]:
        """Expected error, > 0, in units of the mean error."""
        x = F.relu(self.see(observation))
        x = torch.cat((x, 1 / (counts + 0.5), counts / 4), 1)
        x = F.relu(self.mix(F.relu(self.buy(x))))
        return F.softplus(self.tell(x))


@dataclass
class CriticLearner(SamplerLearner):
    """Deterministic policy gradient (Silver et al. 2014) through counts before rounding.

    Each frame is rolled out with `policy.draws` actions around the mean. The critic learns from the
    results by regression; its prediction for the relaxed counts of the mean action is the sampler's
    loss: dense credit, also for the neighbours of a pixel. Past transitions are used again, since
    an error map does not depend on which policy chose the counts.
    """

    network: ErrorMap
    policy: BlockPolicyGradient = BlockPolicyGradient(block=1, margin=0, draws=2)  # noqa: RUF009  (frozen)
    replayed: int = 2  # past transitions in each step, beside the new ones

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """The predicted error of the mean action, plus the critic's regression loss."""
        mean, observation = problem.act(), problem.observation
        corner = self.policy.draw_corner(generator)
        rollout = problem.rollout(self.policy.antithetic_actions(mean, corner, generator))
        results = zip(rollout.counts, rollout.errors, strict=True)
        new = [Transition(observation, counts, errors) for counts, errors in results]
        replay = self.network.replay
        replay.update_scale(rollout.errors.mean())
        regression = self.regression([*new, *replay.sample(self.replayed, generator)])
        replay.past.extend(new)
        frozen = {name: p.detach() for name, p in self.network.named_parameters()}
        counts = problem.relaxed_counts(mean)
        predicted = functional_call(self.network, frozen, (observation, counts))
        drift = mean.mean((1, 2, 3)).square().mean()  # the budget cancels it, and tanh flattens
        total: Tensor = predicted.mean() + regression + drift
        return total

    def regression(self, transitions: list[Transition]) -> Float[Tensor, ""]:
        """Mean squared difference of predicted and realised errors, in units of the mean error."""
        observation, counts, errors = (torch.cat(part) for part in zip(*transitions, strict=True))
        target = (errors / (self.network.replay.scale + EPS)).clamp_max(ERROR_CLIP)
        predicted: Tensor = self.network(observation, counts)
        return (predicted - target).square().mean()


def make_critic_learner(channels: int) -> CriticLearner:
    """A learner for a sampler with observations of `channels`."""
    network = ErrorMap(channels)
    kaiming_init(network)
    return CriticLearner(network)
