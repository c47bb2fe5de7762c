"""The critic: a network that foretells the error map of counts, and the gradient through it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn import functional as F

from methods.ours.policy.block_policy_gradient import BlockPolicyGradient
from methods.ours.policy.interface import AllocationProblem
from rlbench.ops.init import kaiming_init

SMALL = 1e-8  # squared error: keeps the scale of errors from dividing by zero
MOST = 30.0  # times the mean error: what a pixel is cut at, so that no firefly rules the fit


class Transition(NamedTuple):
    """A trial that is remembered."""

    seen: Float[Tensor, "n c h w"]
    counts: Float[Tensor, "n 1 h w"]
    errors: Float[Tensor, "n 1 h w"]


class ReplayBuffer(nn.Module):
    """Trials of the past and the scale of their errors: state of the network that it is a part of.

    So it lies in checkpoints, and a training that was killed goes on as if it had not been.
    """

    scale: Float[Tensor, ""]  # mean error of a pixel, followed; 0 before the first

    def __init__(self, keep: int) -> None:
        """With room for so many trials."""
        super().__init__()
        self.register_buffer("scale", torch.zeros(()))
        self.past: deque[Transition] = deque(maxlen=keep)

    def follow(self, error: Float[Tensor, ""]) -> None:
        """Move the scale towards a mean error."""
        self.scale.copy_(error if self.scale == 0 else 0.98 * self.scale + 0.02 * error)

    def recall(self, number: int, generator: torch.Generator) -> list[Transition]:
        """So many of the past, or none while there are fewer."""
        if len(self.past) < number:
            return []
        chosen = torch.randperm(len(self.past), generator=generator)[:number]
        return [self.past[i] for i in chosen.tolist()]

    def get_extra_state(self) -> Tensor:
        """All trials as one tensor [k n c+2 h w], empty where there are none."""
        rows = [torch.cat(trial, 1) for trial in self.past]
        return torch.stack(rows) if rows else torch.zeros(0)

    def set_extra_state(self, state: Tensor) -> None:
        """Trials as `get_extra_state` gave them."""
        self.past.clear()
        for row in state.to(self.scale.device):
            self.past.append(Transition(row[:, :-2], row[:, -2:-1], row[:, -1:]))


class ErrorMap(nn.Module):
    """Foretells each pixel's error from what the sampler saw and the counts of its surroundings.

    What was seen is read by a 3x3 convolution and says how noisy a pixel is; counts join as
    1 / (n + 1/2), in which the error of a mean is a line, and pass three more.
    """

    def __init__(self, channels: int, width: int = 16, keep: int = 32) -> None:
        """Build for `channels` seen, with room for `keep` trials."""
        super().__init__()
        self.replay = ReplayBuffer(keep)
        self.see = nn.Conv2d(channels, width, 3, padding=1)
        self.buy = nn.Conv2d(width + 2, width, 3, padding=1)
        self.mix = nn.Conv2d(width, width, 3, padding=1)
        self.tell = nn.Conv2d(width, 1, 3, padding=1)

    def forward(
        self, seen: Float[Tensor, "n c h w"], counts: Float[Tensor, "n 1 h w"]
    ) -> Float[Tensor, "n 1 h w"]:
        """Expected error, in units of the mean error; > 0."""
        x = F.relu(self.see(seen))
        x = torch.cat((x, 1 / (counts + 0.5), counts / 4), 1)
        x = F.relu(self.mix(F.relu(self.buy(x))))
        return F.softplus(self.tell(x))


@dataclass
class Critic:
    """Deterministic policy gradient (Silver et al. 2014) through counts that are not yet rounded.

    Each frame is tried `policy.draws` times around the mean action; the trials teach the critic by
    regression, and what the critic says of the relaxed counts of the mean action is the sampler's
    loss: dense credit, also to the neighbours of a pixel. Old trials are regressed on again, since
    an error map does not depend on who asked for the counts.
    """

    network: ErrorMap
    policy: BlockPolicyGradient = BlockPolicyGradient(block=1, margin=0, draws=2)  # noqa: RUF009  (frozen)
    floor: int = 0
    again: int = 2  # old trials regressed on in each step, beside the new ones

    def loss(self, situation: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """What the critic foretells of the mean action, and how wrong it was about the trials."""
        mean, seen = situation.act(), situation.seen
        actions = self.policy.antithetic_actions(mean, self.policy.corner(generator), generator)
        trial = situation.rollout(actions)
        fresh = [Transition(seen, n, e) for n, e in zip(trial.counts, trial.errors, strict=True)]
        replay = self.network.replay
        replay.follow(trial.errors.mean())
        wrong = self.regression([*fresh, *replay.recall(self.again, generator)])
        replay.past.extend(fresh)
        frozen = {name: p.detach() for name, p in self.network.named_parameters()}
        foretold = functional_call(self.network, frozen, (seen, situation.relaxed(mean)))
        drift = mean.mean((1, 2, 3)).square().mean()  # the budget cancels it, and tanh flattens
        total: Tensor = foretold.mean() + wrong + drift
        return total

    def regression(self, trials: list[Transition]) -> Float[Tensor, ""]:
        """How far the critic is from the errors of trials: squared, in units of the mean error."""
        seen, counts, errors = (torch.cat(part) for part in zip(*trials, strict=True))
        wanted = (errors / (self.network.replay.scale + SMALL)).clamp_max(MOST)
        foretold: Tensor = self.network(seen, counts)
        return (foretold - wanted).square().mean()


def learner(channels: int) -> Critic:
    """The learner, for a sampler that sees `channels`."""
    network = ErrorMap(channels)
    kaiming_init(network)
    return Critic(network)
