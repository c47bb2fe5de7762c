"""Training `ours/paper-appo`: one policy over the image acts in every frame of every episode."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from methods.ours.episode_problem import reward
from methods.ours.method import Ours
from methods.ours.policy.joint_appo import JointAppo, Trajectory
from methods.ours.state import RecurrentState
from rlbench.frames import Clip, GBuffer, Samples
from rlbench.ops.losses import log_transfer_loss
from rlbench.run import FrameResult, unroll
from rlbench.training.task import BUDGETS_FROM_0_05_SPP, TrainingTask
from rlbench.wrappers import MethodWrapper

__all__ = ["ActingMethod", "one_policy_task"]

VALUE_LR_MULTIPLIER = 25.0


class Act(NamedTuple):
    """One frame: what the policy saw, its mean, and its action."""

    observation: Float[Tensor, "n c h w"]
    mean: Float[Tensor, "n 1 h w"]
    action: Float[Tensor, "n 1 h w"]


@dataclass(frozen=True)
class ActingMethod(MethodWrapper[Ours]):
    """`ours` with actions that are drawn, and recorded, in every frame."""

    learner: JointAppo
    generator: torch.Generator = field(default_factory=torch.Generator)
    acts: list[Act] = field(default_factory=list)

    def begin_episode(self, seed: int) -> None:
        """Forget the last episode, and seed the actions."""
        self.generator.manual_seed(seed)
        self.acts.clear()
        self.learner.begin_episode()

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> Float[Tensor, "n 1 h w"]:
        """The density of a drawn action."""
        with torch.no_grad():
            observation = self.method.reproject(gbuffer, state).sampler_inputs
        mean, action = self.learner.act(observation, self.generator)
        self.acts.append(Act(observation, mean, action))
        return self.method.to_density(action, gbuffer, state)

    def trajectory(self, rewards: list[Float[Tensor, " n"]]) -> Trajectory:
        """The episode, with the reward of each of its frames."""
        observations, means, actions = map(torch.stack, zip(*self.acts, strict=True))
        return Trajectory(observations, means, actions, torch.stack(rewards))


def one_policy_task(
    method: Ours, device: torch.device, max_lr: float, lr_multipliers: Mapping[str, float]
) -> TrainingTask:
    """Encoder and denoiser learn from every image, the sampler from every episode."""
    networks = method.networks
    assert networks.sampler is not None
    learner = JointAppo.of_sampler(networks.sampler, networks.sampler_channels, method.config.gamma)
    learner.network.to(device)
    return TrainingTask(
        method,
        networks,
        episode_losses(ActingMethod(method, learner)),
        BUDGETS_FROM_0_05_SPP,
        max_lr,
        {**lr_multipliers, "auxiliary_network": VALUE_LR_MULTIPLIER},
        auxiliary_network=learner.network,
    )


def episode_losses(acting: ActingMethod) -> Callable[[Clip, float], Iterator[Tensor]]:
    """The losses of an episode: one a frame for the image, then the policy's."""

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        acting.begin_episode(next(iter(clip)).pool.rounding_seeds[0])
        rewards = []
        for result in unroll(acting, clip, spp):
            loss = image_losses(result)
            rewards.append(reward(loss.detach().float()))
            yield loss.mean()
        trajectory = acting.trajectory(rewards)
        for _ in range(acting.learner.passes):
            yield acting.learner.loss(trajectory)

    return losses


def image_losses(result: FrameResult) -> Float[Tensor, " n"]:
    """0.16 L1 + 0.84 (1 - MS-SSIM) of each image, in log transfer."""
    pairs = zip(result.image, result.frame.reference.mean, strict=True)
    return torch.stack([log_transfer_loss(image[None], truth[None]) for image, truth in pairs])
