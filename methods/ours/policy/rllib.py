"""RLlib's pieces: environment, module and per-pixel learner, on its current API stack."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
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

from methods.ours.policy.appo import AppoSettings
from methods.ours.policy.joint_appo import pixel_ratios
from methods.ours.policy.learner import Env
from methods.ours.policy.reinforce import advantage, budget_coupling, remove_common_change

RESULT_CHANNELS = 2  # behind the observation: error and count of the previous action
FINAL_RATE = 0.1  # learning rate at the end, as a share of that at the start
ADVANTAGE_CLIP = 3.0  # standard deviations
DRIFT_WEIGHT = 1.0  # of the squared mean action, which the budget cancels
TINY = 1e-8


class GymSamplingEnv(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """An Env as gymnasium has it: one action per pixel, reward 10^(1 - mean error).

    The last two channels of an observation are errors and counts of the previous action. The
    sampler never reads them: they give the learner the results of single pixels, which a reward
    cannot hold.
    """

    def __init__(self, config: dict[str, Any]) -> None:
        """`config["make_env"]` makes an Env."""
        self.env: Env = config["make_env"]()
        channels, h, w = self.env.shape
        shape = (channels + RESULT_CHANNELS, h, w)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (h * w,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """The next episode. `seed` is ignored: `make_env` seeds the environment."""
        observation = self.env.reset()
        zero = torch.zeros_like(observation[:, :1])
        return _join(observation, zero, zero), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One frame. Episodes are truncated, not terminated, after their last frame."""
        _, h, w = self.env.shape
        result = self.env.step(torch.as_tensor(action).view(1, 1, h, w))
        reward = 10 ** (1 - float(result.errors.mean()))
        observation = _join(result.observation, result.errors, result.counts)
        return observation, reward, False, result.truncated, {}


def _join(observation: Tensor, errors: Tensor, counts: Tensor) -> Any:
    return torch.cat((observation, errors, counts), 1)[0].float().numpy()


class SamplerModule(TorchRLModule, ValueFunctionAPI, TargetNetworkAPI):  # type: ignore[misc]
    """Any sampler as an RLModule: its action is the mean of a Gaussian of fixed deviation.

    Beside it a value of the whole frame, for the joint ratio, and maps of the expected error and
    count, for the ratio per pixel.
    """

    def setup(self) -> None:
        """Build from `model_config`: make_sampler, action_std."""
        channels = self.observation_space.shape[0] - RESULT_CHANNELS
        self.sampler = self.model_config["make_sampler"]()
        self.maps = nn.Sequential(
            nn.Conv2d(channels, 16, 3, padding=1), nn.ReLU(), nn.Conv2d(16, 2, 3, padding=1)
        )
        self.worth = nn.Linear(channels, 1)

    def sampler_inputs(self, batch: dict[str, Any]) -> Tensor:
        """Observations without the results of the previous action."""
        observed: Tensor = batch[Columns.OBS]
        return observed[:, :-RESULT_CHANNELS].float()

    def _distribution(self, sampler: nn.Module, batch: dict[str, Any]) -> Tensor:
        mean = sampler(self.sampler_inputs(batch)).flatten(1)
        deviation = torch.full_like(mean, self.model_config["action_std"])
        return torch.cat((mean, deviation.log()), 1)

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Tensor]:
        return {Columns.ACTION_DIST_INPUTS: self._distribution(self.sampler, batch)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> Tensor:
        """One value per frame."""
        value: Tensor = self.worth(self.sampler_inputs(batch).mean((2, 3)))
        return value[:, 0]

    def make_target_networks(self) -> None:
        """Copy the sampler; RLlib updates the copy with a delay."""
        self._target_sampler = make_target_network(self.sampler)

    def get_target_network_pairs(self) -> list[tuple[nn.Module, nn.Module]]:
        """Pairs of a network and its delayed copy."""
        return [(self.sampler, self._target_sampler)]

    def forward_target(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Tensor]:
        """The action distribution of the delayed copy."""
        distribution = self._distribution(self._target_sampler, batch)
        return {TARGET_NETWORK_ACTION_DIST_INPUTS: distribution}


class PixelLearner(APPOTorchLearner):  # type: ignore[misc]
    """APPO's loop with a loss of its own: ratios, advantages and a price for single pixels."""

    def compute_loss_for_module(
        self, *, module_id: str, config: Any, batch: dict[str, Any], fwd_out: dict[str, Tensor]
    ) -> Tensor:
        """The clipped loss of each pixel, and the regression loss of the maps of error and count.

        An action's results lie in the next observation; RLlib adds one frame to each fragment.
        """
        module, settings = self.module[module_id].unwrapped(), config.learner_config_dict
        acted = batch[Columns.LOSS_MASK].bool().nonzero()[:, 0]
        results = batch[Columns.OBS][acted + 1, -RESULT_CHANNELS:].float()
        maps = module.maps(module.sampler_inputs(batch)[acted])
        regression, gain, common = _pixel_advantages(maps, results, settings)
        mean, log_std = fwd_out[Columns.ACTION_DIST_INPUTS][acted].chunk(2, 1)
        current = mean
        if settings["price_weight"]:
            change = remove_common_change(mean - mean.detach(), common, (1,))
            current = mean.detach() + change
        previous = batch[Columns.ACTION_DIST_INPUTS][acted].chunk(2, 1)[0]
        action = batch[Columns.ACTIONS][acted]
        ratio = pixel_ratios(current, previous, action, log_std.exp())
        clipped = ratio.clamp(1 - config.clip_param, 1 + config.clip_param)
        objective = torch.minimum(ratio * gain, clipped * gain).mean()
        total: Tensor = regression - objective + DRIFT_WEIGHT * mean.mean(1).square().mean()
        return total


def _pixel_advantages(
    maps: Tensor, results: Tensor, settings: dict[str, Any]
) -> tuple[Tensor, Tensor, Tensor]:
    """Regression loss of the maps, advantages [n hw], and the common direction [n hw]."""
    errors, counts = results.chunk(2, 1)
    errors = errors / errors.mean().clamp_min(TINY)
    regression = (maps - torch.cat((errors, counts), 1)).square().mean()
    error, count = (torch.cat((errors, counts), 1) - maps.detach()).chunk(2, 1)
    side = 2 * settings["reach"] + 1
    error = F.avg_pool2d(error, side, 1, settings["reach"], count_include_pad=False) * side**2
    usual, image = maps[:, 1:].detach().clamp_min(0), (1, 2, 3)
    weight, common = budget_coupling(usual, settings["multiplicative"])
    gain = advantage(error, count, weight, image, settings["price_weight"], ADVANTAGE_CLIP)
    return regression, gain.flatten(1), common.flatten(1)


def algorithm_config(
    make_env: Callable[[], Env],
    make_sampler: Callable[[], nn.Module],
    frames: int,
    settings: AppoSettings,
    seed: int,
) -> APPOConfig:
    """RLlib's configuration of one training."""
    model = {"make_sampler": make_sampler, "action_std": settings.action_std}
    rate, length = settings.learning_rate, settings.fragment_length
    return (
        APPOConfig()
        .environment(GymSamplingEnv, env_config={"make_env": make_env}, normalize_actions=False)
        .framework("torch")
        .env_runners(num_env_runners=settings.env_runners, rollout_fragment_length=length)
        .learners(num_learners=0)
        .training(
            lr=[[0, rate], [frames, FINAL_RATE * rate]],
            train_batch_size_per_learner=length,
            clip_param=settings.clip,
            grad_clip=4.0,
            entropy_coeff=0.0,  # the deviation is fixed
            circular_buffer_num_batches=4,
            circular_buffer_iterations_per_batch=2,
            learner_class=APPOTorchLearner if settings.joint_ratio else PixelLearner,
            learner_config_dict={
                "reach": settings.reach,
                "price_weight": settings.price_weight,
                "multiplicative": settings.multiplicative,
            },
        )
        .rl_module(rl_module_spec=RLModuleSpec(module_class=SamplerModule, model_config=model))
        .reporting(min_time_s_per_iteration=0, min_sample_timesteps_per_iteration=100)
        .debugging(seed=seed, log_level="ERROR")
    )
