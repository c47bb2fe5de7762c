"""The critic: a network that foretells the error map of counts, and the gradient through it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn import functional as F

from methods.ours.policy.blocks import Policy
from methods.ours.policy.learner import Situation
from rlbench.ops.initialise import initialise

SMALL = 1e-8  # squared error: keeps the scale of errors from dividing by zero
MOST = 30.0  # times the mean error: what a pixel is cut at, so that no firefly rules the fit


class Past(NamedTuple):
    """A trial that is remembered."""

    seen: Float[Tensor, "n c h w"]
    counts: Float[Tensor, "n 1 h w"]
    errors: Float[Tensor, "n 1 h w"]


class ErrorMap(nn.Module):
    """Foretells each pixel's error from what the sampler saw and the counts of its surroundings.

    What was seen is read by a 3x3 convolution and says how noisy a pixel is; counts join as
    1 / (n + 1/2), in which the error of a mean is a line, and pass three more.
    """

    def __init__(self, channels: int, width: int = 16) -> None:
        """Build for `channels` seen."""
        super().__init__()
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
    policy: Policy = Policy(block=1, margin=0, draws=2)  # noqa: RUF009  (frozen)
    floor: int = 0
    keep: int = 32  # trials remembered
    again: int = 2  # of them regressed on in each step, beside the new ones
    scale: float = 0.0  # mean error of a pixel, followed
    past: deque[Past] = field(default_factory=deque)

    def loss(self, situation: Situation, generator: torch.Generator) -> Float[Tensor, ""]:
        """What the critic foretells of the mean action, and how wrong it was about the trials."""
        mean, seen = situation.act(), situation.seen
        actions = self.policy.tries(mean, self.policy.corner(generator), generator)
        trial = situation.attempt(actions)
        fresh = [Past(seen, n, e) for n, e in zip(trial.counts, trial.errors, strict=True)]
        self._follow(float(trial.errors.mean()))
        wrong = self.regression([*fresh, *self._recall(generator)])
        self._remember(fresh)
        frozen = {name: p.detach() for name, p in self.network.named_parameters()}
        foretold = functional_call(self.network, frozen, (seen, situation.relaxed(mean)))
        drift = mean.mean((1, 2, 3)).square().mean()  # the budget cancels it, and tanh flattens
        total: Tensor = foretold.mean() + wrong + drift
        return total

    def regression(self, trials: list[Past]) -> Float[Tensor, ""]:
        """How far the critic is from the errors of trials: squared, in units of the mean error."""
        seen, counts, errors = (torch.cat(part) for part in zip(*trials, strict=True))
        wanted = (errors / (self.scale + SMALL)).clamp_max(MOST)
        foretold: Tensor = self.network(seen, counts)
        return (foretold - wanted).square().mean()

    def _follow(self, error: float) -> None:
        self.scale = error if self.scale == 0 else 0.98 * self.scale + 0.02 * error

    def _recall(self, generator: torch.Generator) -> list[Past]:
        if len(self.past) < self.again:
            return []
        chosen = torch.randperm(len(self.past), generator=generator)[: self.again]
        return [self.past[i] for i in chosen.tolist()]

    def _remember(self, fresh: list[Past]) -> None:
        self.past.extend(fresh)
        while len(self.past) > self.keep:
            self.past.popleft()


def learner(channels: int) -> Critic:
    """The learner, for a sampler that sees `channels`."""
    network = ErrorMap(channels)
    initialise(network)
    return Critic(network)
