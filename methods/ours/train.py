"""Training `ours`: encoder and denoiser by backpropagation, the sampler by its learner.

Command: rlbench train --methods ours
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from baselines.oidn.train import FINE_TUNING_MAX_LR
from methods.ours import FAMILY, LATENT, VARIANTS, Config
from methods.ours.history import RecurrentState, detach
from methods.ours.initialization import initialize
from methods.ours.method import Ours, assemble
from methods.ours.networks import Networks
from methods.ours.policy import APPO, BlockPolicyGradient, make_learner
from methods.ours.policy.joint_appo import JointAppo, Trajectory
from methods.ours.problem import EpisodeProblem, FrameProblem, reward
from rlbench.family import Traits
from rlbench.frames import Clip, Frame, GBuffer, Samples
from rlbench.ops.losses import display_mse, log_loss, log_transfer_loss
from rlbench.run import FrameResult, unroll
from rlbench.training.task import BUDGETS_FROM_0_05_SPP, TrainingTask
from rlbench.wrappers import MethodWrapper

MAX_LR = 3e-4  # from random weights
LR_MULTIPLIERS = {"encoder": 0.2, "sampler": 3.0}  # at 1.0 the encoder's tanh saturates
FINETUNING_MULTIPLIERS = {"encoder": 2.0, "sampler": 6.0, "auxiliary_network": 25.0}
VALUE_LR_MULTIPLIER = 25.0  # of the value of JointAppo
SAMPLER_INTERVAL = 2  # frames between steps of the sampler
RECORDABLE = ("reinforce", "reinforce+surrogate", "surrogate")  # learners
DRAWS = "what the sampler learns from is drawn by the host"
SAMPLER_WEIGHT = 0.1  # of the learner's loss; only the sampler gets it, so it matters for clipping


@dataclass
class _Sequence:
    """The part of an ExploringMethod that changes while a sequence is unrolled."""

    is_noisy: Bool[Tensor, ""] | None = None
    planned: tuple[GBuffer, RecurrentState] | None = None


@dataclass(frozen=True)
class ExploringMethod(MethodWrapper[Ours]):
    """`ours` during training: adds noise to the actions of every second sequence on average.

    It keeps the inputs of the last `plan`, from which the learner builds its FrameProblem.
    """

    policy: BlockPolicyGradient = BlockPolicyGradient()
    generator: torch.Generator = field(default_factory=torch.Generator)
    sequence: _Sequence = field(default_factory=_Sequence)

    def begin_sequence(self) -> None:
        """Draw whether this sequence has noise."""
        drawn = torch.randint(2, (), generator=self.generator, device=self.generator.device)
        self.sequence.is_noisy = drawn > 0

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: RecurrentState
    ) -> Float[Tensor, "n 1 h w"]:
        """The density of the sampler's action, or of a noisy action."""
        if self.method.sampler is None:
            return self.method.plan(gbuffer, samples, state)
        self.sequence.planned = (gbuffer, detach(state))
        with torch.no_grad():
            action = self.method.act(gbuffer, state)
        corner = self.policy.draw_corner(self.generator)
        noisy = self.policy.explore(action, corner, self.generator)
        assert self.sequence.is_noisy is not None, "plan before begin_sequence"
        action = noisy.where(self.sequence.is_noisy, action)
        return self.method.to_density(action, gbuffer, state)

    def last_problem(self, frame: Frame, spp: float) -> FrameProblem:
        """The allocation problem of the frame that was planned last."""
        assert self.sequence.planned is not None, "last_problem before plan"
        return FrameProblem(self.method, frame, *self.sequence.planned, spp)


def training_task(variant: str, device: torch.device, seed: int) -> TrainingTask:
    """Networks with seeded weights and a uniform sampler, and the losses that train them."""
    return config_task(VARIANTS[variant], FAMILY.variants[variant].traits, device, seed)


def config_task(config: Config, traits: Traits, device: torch.device, seed: int) -> TrainingTask:
    """The training task of a config.

    With truncated backpropagation through k frames there is one step for k frames, and the learning
    rate is sqrt(k) times as high.
    """
    config = config.for_training
    networks = Networks(config)
    origin = initialize(networks, config, seed)
    networks.to(device)
    method = assemble(config, traits, networks)
    if config.learner == APPO:
        return one_policy_task(method, device)
    learner = make_learner(config.learner, networks.sampler_channels)
    auxiliary = learner.network.to(device) if learner.network is not None else None
    exploring = ExploringMethod(method, generator=find_generator(device))

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        exploring.begin_sequence()
        total, frames = torch.zeros((), device=device), 0
        episode = list(clip) if config.gamma else []
        for result in unroll(exploring, clip, spp):
            loss = frame_loss(config, result.image, result.frame.reference.mean)
            if config.log_loss:  # else small budgets and hard scenes dominate
                loss = log_loss(loss)
            if networks.sampler is not None and result.frame.index % SAMPLER_INTERVAL == 0:
                problem = exploring.last_problem(result.frame, spp)
                if config.gamma:
                    later = episode[frames + 1 :]
                    problem = EpisodeProblem.of_problem(problem, later, config.gamma)
                loss = loss + SAMPLER_WEIGHT * learner.loss(problem, exploring.generator)
            total, frames = total + loss, frames + 1
            if frames % config.bptt == 0 or frames == len(clip):
                yield total / config.bptt
                total = torch.zeros_like(total)

    budgets = tuple(spp for spp in BUDGETS_FROM_0_05_SPP if traits.unsupported_reason(spp) is None)
    max_lr, multipliers = (
        (FINE_TUNING_MAX_LR, FINETUNING_MULTIPLIERS) if origin else (MAX_LR, LR_MULTIPLIERS)
    )
    sampler_multiplier = multipliers["sampler"] * width_multiplier(config.sampler)
    multipliers = {**multipliers, "sampler": sampler_multiplier}
    return TrainingTask(
        method,
        networks,
        losses,
        budgets,
        max_lr * math.sqrt(config.bptt),
        multipliers,
        origin=origin,
        pretrained=("denoiser.",) if origin else (),
        on_sequence=lambda clip: seed_by_clip(exploring.generator, clip),
        auxiliary_network=auxiliary,
        eager_reason="" if networks.sampler is None or config.learner in RECORDABLE else DRAWS,
    )


def find_generator(device: torch.device) -> torch.Generator:
    """What draws random numbers on a device: on a GPU, PyTorch's own, which CUDA graphs know."""
    if device.type == "cuda":
        return torch.cuda.default_generators[device.index or 0]
    return torch.Generator(device)


def seed_by_clip(generator: torch.Generator, clip: Clip) -> None:
    """Equal clips give equal draws."""
    generator.manual_seed(next(iter(clip)).pool.rounding_seeds[0])


def frame_loss(
    config: Config, image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, ""]:
    """The loss of an image, both in linear radiance."""
    if config.loss == "display":
        return display_mse(image, reference)
    return log_transfer_loss(image, reference)


def width_multiplier(widths: tuple[int, ...]) -> float:
    """Factor on the learning rate of a sampler that is wider than that of `ours`.

    A step of Adam changes a layer's output equally at any width if the rate falls with the width
    (Yang et al. 2021, table 3). At the full rate the map of a sampler 16 times as wide collapses to
    stripes.
    """
    return min(1.0, LATENT.sampler[0] / widths[0]) if widths else 1.0


class Act(NamedTuple):
    """One frame: what the policy saw, its mean, and its action."""

    observation: Float[Tensor, "n c h w"]
    mean: Float[Tensor, "n 1 h w"]
    action: Float[Tensor, "n 1 h w"]


@dataclass(frozen=True)
class ActingMethod(MethodWrapper[Ours]):
    """`ours` with actions that are drawn, and recorded, in every frame."""

    learner: JointAppo
    generator: torch.Generator
    acts: list[Act] = field(default_factory=list)

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


def one_policy_task(method: Ours, device: torch.device) -> TrainingTask:
    """`ours/paper-appo`: encoder and denoiser learn from every image, one policy from episodes."""
    networks = method.networks
    assert networks.sampler is not None
    learner = JointAppo.of_sampler(networks.sampler, networks.sampler_channels, method.config.gamma)
    learner.network.to(device)
    acting = ActingMethod(method, learner, find_generator(device))

    def on_sequence(clip: Clip) -> None:
        seed_by_clip(acting.generator, clip)
        learner.begin_episode()

    return TrainingTask(
        method,
        networks,
        episode_losses(acting),
        BUDGETS_FROM_0_05_SPP,
        MAX_LR,
        {**LR_MULTIPLIERS, "auxiliary_network": VALUE_LR_MULTIPLIER},
        on_sequence=on_sequence,
        auxiliary_network=learner.network,
    )


def episode_losses(acting: ActingMethod) -> Callable[[Clip, float], Iterator[Tensor]]:
    """The losses of an episode: one a frame for the image, then the policy's."""

    def losses(clip: Clip, spp: float) -> Iterator[Tensor]:
        acting.acts.clear()
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
