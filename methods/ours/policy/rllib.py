"""RLlib's pieces: environment, module and per-pixel learner, on its current API stack."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import ray
import torch
from ray.rllib.algorithms.appo import APPOConfig
from ray.rllib.algorithms.appo.torch.appo_torch_learner import APPOTorchLearner
from ray.rllib.core.columns import Columns
from ray.rllib.core.learner.utils import make_target_network
from ray.rllib.core.rl_module.apis import (
    TARGET_NETWORK_ACTION_DIST_INPUTS,
    TargetNetworkAPI,
    ValueFunctionAPI,
)
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.torch import TorchRLModule
from torch import Tensor, nn
from torch.nn import functional as F

from methods.ours.policy.appo_config import Appo
from methods.ours.policy.block_policy_gradient import advantage, coupling, own
from methods.ours.policy.environment import OUTCOMES, Env

MODULE = "default_policy"
FALL = 0.1  # learning rate at the end, of that at the start
MOST = 3.0  # deviations that an advantage is cut at
DRIFT = 1.0  # weight of the squared mean action, which the budget cancels
TINY = 1e-8


class Sampling(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """A world as gymnasium has it: one action a pixel, reward 10^(1 - mean error).

    The last two channels of an observation are errors and counts of the action before. The sampler
    never reads them: they are how the learner gets to know of single pixels what a reward cannot
    say.
    """

    def __init__(self, config: dict[str, Any]) -> None:
        """`config` holds `world`, which makes one."""
        self.world: Env = config["world"]()
        channels, h, w = self.world.shape
        shape = (channels + OUTCOMES, h, w)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (h * w,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """The next episode; worlds are seeded where they are made."""
        seen = self.world.reset()
        nought = torch.zeros_like(seen[:, :1])
        return _observation(seen, nought, nought), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One frame; episodes are cut, not ended, after their last."""
        _, h, w = self.world.shape
        came = self.world.step(torch.as_tensor(action).view(1, 1, h, w))
        reward = 10 ** (1 - float(came.errors.mean()))
        return _observation(came.seen, came.errors, came.counts), reward, False, came.over, {}


def _observation(seen: Tensor, errors: Tensor, counts: Tensor) -> Any:
    return torch.cat((seen, errors, counts), 1)[0].float().numpy()


class SamplerModule(TorchRLModule, ValueFunctionAPI, TargetNetworkAPI):  # type: ignore[misc]
    """Any sampler as an RLModule: its action is the mean of a Gaussian of fixed deviation.

    Beside it a value of the whole frame, for the joint ratio, and maps of the expected error and
    count, for the ratio of each pixel.
    """

    def setup(self) -> None:
        """Build from `model_config`: sampler, spread."""
        channels = self.observation_space.shape[0] - OUTCOMES
        self.sampler = self.model_config["sampler"]()
        self.maps = nn.Sequential(
            nn.Conv2d(channels, 16, 3, padding=1), nn.ReLU(), nn.Conv2d(16, 2, 3, padding=1)
        )
        self.worth = nn.Linear(channels, 1)

    def seen(self, batch: dict[str, Any]) -> Tensor:
        """Observations without what came of the action before."""
        observed: Tensor = batch[Columns.OBS]
        return observed[:, :-OUTCOMES].float()

    def _gauss(self, sampler: nn.Module, batch: dict[str, Any]) -> Tensor:
        mean = sampler(self.seen(batch)).flatten(1)
        deviation = torch.full_like(mean, self.model_config["spread"])
        return torch.cat((mean, deviation.log()), 1)

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Tensor]:
        return {Columns.ACTION_DIST_INPUTS: self._gauss(self.sampler, batch)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> Tensor:
        """One value a frame."""
        value: Tensor = self.worth(self.seen(batch).mean((2, 3)))
        return value[:, 0]

    def make_target_networks(self) -> None:
        """The sampler of some updates ago."""
        self._before = make_target_network(self.sampler)

    def get_target_network_pairs(self) -> list[tuple[nn.Module, nn.Module]]:
        """Which follows which."""
        return [(self.sampler, self._before)]

    def forward_target(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Tensor]:
        """Its action."""
        return {TARGET_NETWORK_ACTION_DIST_INPUTS: self._gauss(self._before, batch)}


class PixelLearner(APPOTorchLearner):  # type: ignore[misc]
    """APPO's loop with a loss of its own: ratios, advantages and a price for single pixels."""

    def compute_loss_for_module(
        self, *, module_id: str, config: Any, batch: dict[str, Any], fwd_out: dict[str, Tensor]
    ) -> Tensor:
        """Clipped loss of each pixel, and how wrong the maps of error and count are.

        An action's outcome lies in the next observation; RLlib adds one frame to each fragment.
        """
        module, settings = self.module[module_id].unwrapped(), config.learner_config_dict
        acted = batch[Columns.LOSS_MASK].bool().nonzero()[:, 0]
        seen = module.seen(batch)[acted]
        errors, counts = batch[Columns.OBS][acted + 1, -OUTCOMES:].float().split(1, 1)
        errors = errors / errors.mean().clamp_min(TINY)
        maps = module.maps(seen)
        wrong = (maps - torch.cat((errors, counts), 1)).square().mean()
        worse, more = (torch.cat((errors, counts), 1) - maps.detach()).split(1, 1)
        side = 2 * settings["reach"] + 1
        worse = F.avg_pool2d(worse, side, 1, settings["reach"], count_include_pad=False) * side**2
        usual, image = maps[:, 1:].detach().clamp_min(0), (1, 2, 3)
        weight, shared = coupling(usual, settings["factors"])
        gain = advantage(worse, more, weight, image, settings["priced"], MOST).flatten(1)
        mean, spread = fwd_out[Columns.ACTION_DIST_INPUTS][acted].chunk(2, 1)
        now = mean
        if settings["priced"]:
            now = mean.detach() + own(mean - mean.detach(), shared.flatten(1), (1,))
        then = batch[Columns.ACTION_DIST_INPUTS][acted].chunk(2, 1)[0]
        action = batch[Columns.ACTIONS][acted]
        away = (action - now).square() - (action - then).square()
        ratio = (-away / 2 / spread.exp().square()).exp()
        clipped = ratio.clamp(1 - config.clip_param, 1 + config.clip_param)
        reached = torch.minimum(ratio * gain, clipped * gain).mean()
        total: Tensor = wrong - reached + DRIFT * mean.mean(1).square().mean()
        return total


def train(
    world: Callable[[], Env],
    sampler: Callable[[], nn.Module],
    frames: int,
    settings: Appo,
    seed: int,
    every: int,
    report: Callable[[int, nn.Module], None],
) -> nn.Module:
    """See methods.ours.policy.appo.train."""
    ours = not ray.is_initialized()
    if ours:
        ray.init(
            num_cpus=1 + settings.runners,
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            object_store_memory=256 * 2**20,
        )
    algorithm = None
    try:
        algorithm = _config(world, sampler, frames, settings, seed).build_algo()
        module, seen, told = algorithm.learner_group._learner.module[MODULE], 0, 0
        while seen < frames:
            result = algorithm.train()
            seen = int(result["env_runners"]["num_env_steps_sampled_lifetime"])
            if seen // every > told // every:
                told = seen
                report(seen, module.unwrapped().sampler)
        trained: nn.Module = module.unwrapped().sampler
        return trained
    finally:
        if algorithm is not None:
            algorithm.stop()
        if ours:
            ray.shutdown()


def _config(
    world: Callable[[], Env],
    sampler: Callable[[], nn.Module],
    frames: int,
    settings: Appo,
    seed: int,
) -> Any:
    model = {"sampler": sampler, "spread": settings.action_std}
    learner = APPOTorchLearner if settings.joint else PixelLearner
    return (
        APPOConfig()
        .environment(Sampling, env_config={"world": world}, normalize_actions=False)
        .framework("torch")
        .env_runners(num_env_runners=settings.runners, rollout_fragment_length=settings.fragment)
        .learners(num_learners=0)
        .training(
            lr=[[0, settings.rate], [frames, FALL * settings.rate]],
            train_batch_size_per_learner=settings.fragment,
            clip_param=settings.clip,
            grad_clip=4.0,
            entropy_coeff=0.0,  # the deviation is fixed
            circular_buffer_num_batches=4,
            circular_buffer_iterations_per_batch=2,
            learner_class=learner,
            learner_config_dict={
                "reach": settings.reach,
                "priced": settings.price_weight,
                "factors": settings.multiplicative,
            },
        )
        .rl_module(rl_module_spec=RLModuleSpec(module_class=SamplerModule, model_config=model))
        .reporting(min_time_s_per_iteration=0, min_sample_timesteps_per_iteration=100)
        .debugging(seed=seed, log_level="ERROR")
    )
