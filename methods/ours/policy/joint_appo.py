"""APPO with one policy over the image, as in the paper: one ratio and one reward a frame."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rlbench.ops.init import kaiming_init
from rlbench.ops.padding import crop, pad

MULTIPLE = 16  # pixels; observations are padded to a multiple of this
VALUE_SCALE = 10.0  # the highest reward
VALUE_WEIGHT = 0.5  # of the value's regression in the loss, as in the release
MAX_IS_RATIO = 2.0  # of the acting policy to the delayed one, as in RLlib
MAX_LOG_RATIO = 20.0  # RLlib has no such limit, and its loss overflows


class Trajectory(NamedTuple):
    """The frames of one episode, and what the policy did in them."""

    observations: Float[Tensor, "t n c h w"]
    means: Float[Tensor, "t n 1 h w"]  # of the policy that acted
    actions: Float[Tensor, "t n 1 h w"]
    rewards: Float[Tensor, "t n"]  # one a frame


class JointAppoNetwork(nn.Module):
    """What APPO trains or keeps beside the sampler: the value of a frame, and a delayed sampler."""

    episodes: Tensor  # seen so far

    def __init__(self, channels: int, sampler: nn.Module) -> None:
        """Build for observations of `channels`, with a copy of `sampler`."""
        super().__init__()
        self.value = nn.Linear(channels, 1)
        kaiming_init(self.value)
        self.delayed = copy.deepcopy(sampler).requires_grad_(False)
        self.register_buffer("episodes", torch.zeros((), dtype=torch.long))

    def values(self, observations: Float[Tensor, "t n c h w"]) -> Float[Tensor, "t n"]:
        """The expected discounted return from each frame on."""
        value: Tensor = VALUE_SCALE * self.value(observations.mean((-2, -1)))
        return value[..., 0]


@dataclass(frozen=True)
class JointAppo:
    """One Gaussian over all pixels, a reward for each frame, and the clipped loss of APPO.

    The loss is that of RLlib's APPO: V-trace (Espeholt et al. 2018) towards a delayed copy of the
    sampler, and a clipped ratio of the joint probability of all pixels, which leaves the clip range
    after one step (docs/concepts/learning-to-sample.md).

    Differs from the paper: one process acts and learns in turn; an episode is one draw of crops, as
    long as training clips are; the standard deviation of the action is fixed.
    """

    sampler: nn.Module
    network: JointAppoNetwork
    gamma: float = 0.99  # discount per frame
    clip: float = 0.15  # of the ratio, around 1, as in the release
    action_std: float = 0.3  # standard deviation of the action, whose range is [-1, 1]
    passes: int = 2  # steps on each episode, as in RLlib
    delay: int = 2  # episodes between updates of the delayed sampler

    @classmethod
    def of_sampler(cls, sampler: nn.Module, channels: int, gamma: float) -> JointAppo:
        """The learner of a sampler with observations of `channels`."""
        return cls(sampler, JointAppoNetwork(channels, sampler), gamma)

    @torch.no_grad()
    def act(
        self, observation: Float[Tensor, "n c h w"], generator: torch.Generator
    ) -> tuple[Float[Tensor, "n 1 h w"], Float[Tensor, "n 1 h w"]]:
        """The mean action, and an action drawn around it, pixel by pixel."""
        mean = mean_action(self.sampler, observation)
        noise = torch.randn(mean.shape, generator=generator, device=generator.device)
        return mean, mean + self.action_std * noise.to(mean.device)

    def begin_episode(self) -> None:
        """Update the delayed sampler, every `delay` episodes."""
        if self.network.episodes % self.delay == 0:
            self.network.delayed.load_state_dict(self.sampler.state_dict())
        self.network.episodes += 1

    def loss(self, trajectory: Trajectory) -> Float[Tensor, ""]:
        """The clipped loss of the policy, and the regression of the values."""
        inputs = trajectory.observations
        current = self._log_ratio(self.sampler, trajectory)
        with torch.no_grad():
            delayed = self._log_ratio(self.network.delayed, trajectory)
        values = self.network.values(inputs)
        targets, gain = vtrace(delayed, trajectory.rewards, values.detach(), self.gamma)
        is_ratio = (-delayed).clamp_max(math.log(MAX_IS_RATIO)).exp()
        ratio = is_ratio * current.clamp_max(MAX_LOG_RATIO).exp()
        clipped = ratio.clamp(1 - self.clip, 1 + self.clip)
        objective = torch.minimum(ratio * gain, clipped * gain).mean()
        regression = (values - targets).square().mean() / 2
        return VALUE_WEIGHT * regression - objective

    def _log_ratio(self, sampler: nn.Module, trajectory: Trajectory) -> Float[Tensor, "t n"]:
        """Logarithm of the actions' joint probability under a sampler over that when they acted."""
        mean = mean_action(sampler, trajectory.observations.flatten(0, 1))
        mean = mean.view_as(trajectory.means)
        ratios = log_ratios(mean, trajectory.means, trajectory.actions, self.action_std)
        return ratios.sum((-3, -2, -1))


def mean_action(
    sampler: nn.Module, observation: Float[Tensor, "n c h w"]
) -> Float[Tensor, "n 1 h w"]:
    """The sampler's action in float32: sums over all pixels amplify the error of half floats."""
    h, w = observation.shape[-2:]
    with torch.autocast(observation.device.type, enabled=False):
        action: Tensor = sampler(pad(observation.float(), MULTIPLE))
    return crop(action, h, w)


def pixel_ratios(
    current: Float[Tensor, "*k p"],
    previous: Float[Tensor, "*k p"],
    action: Float[Tensor, "*k p"],
    action_std: Float[Tensor, "*k p"] | float,
) -> Float[Tensor, "*k p"]:
    """Probability of each pixel's action under the current mean over that under the previous one.

    `action_std` is the standard deviation of both.

    >>> mean = torch.zeros(2)
    >>> pixel_ratios(mean, mean, torch.ones(2), 0.3)
    tensor([1., 1.])
    """
    return log_ratios(current, previous, action, action_std).exp()


def joint_ratio(
    current: Float[Tensor, "*k p"],
    previous: Float[Tensor, "*k p"],
    action: Float[Tensor, "*k p"],
    action_std: Float[Tensor, "*k p"] | float,
) -> Float[Tensor, "*k"]:
    """The product over all pixels: the ratio of RLlib's APPO for an action with p values."""
    return log_ratios(current, previous, action, action_std).sum(-1).exp()


def log_ratios(
    current: Tensor, previous: Tensor, action: Tensor, action_std: Tensor | float
) -> Tensor:
    """Logarithms of `pixel_ratios`."""
    distance = (action - current).square() - (action - previous).square()
    return -distance / 2 / action_std**2


def vtrace(
    log_ratio: Float[Tensor, "t n"],
    rewards: Float[Tensor, "t n"],
    values: Float[Tensor, "t n"],
    gamma: float,
) -> tuple[Float[Tensor, "t n"], Float[Tensor, "t n"]]:
    """V-trace targets of the values, and advantages, of an episode that ends with its last frame.

    `log_ratio` is the logarithm of the target policy's probability over that of the policy that
    acted; ratios are clipped at 1.

    >>> rewards, zero = torch.tensor([[1.0], [2.0], [4.0]]), torch.zeros(3, 1)
    >>> vtrace(zero, rewards, zero, gamma=0.5)[0].flatten()  # equal policies: discounted returns
    tensor([3., 4., 4.])
    """
    ratio = log_ratio.clamp_max(0).exp()
    gains = ratio * (rewards + gamma * _next(values) - values)
    correction, corrections = torch.zeros_like(values[0]), []
    for gain, weight in zip(gains.flip(0), ratio.flip(0), strict=True):
        correction = gain + gamma * weight * correction
        corrections.append(correction)
    targets = values + torch.stack(corrections[::-1])
    return targets, ratio * (rewards + gamma * _next(targets) - values)


def _next(values: Tensor) -> Tensor:
    """The value of the next frame; 0 after the last."""
    return torch.cat((values[1:], torch.zeros_like(values[:1])))
