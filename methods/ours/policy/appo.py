"""The paper's own tool: RLlib's APPO around an environment, on one machine or many."""

from __future__ import annotations

import importlib.util
import logging
import os
from collections.abc import Callable
from dataclasses import dataclass

from torch import nn

from methods.ours.policy.learner import Env
from rlbench.errors import RlbenchError
from rlbench.parallel.engines import QUIET_RAY

MODULE = "default_policy"  # of RLlib's learner
NEEDED = ("ray", "gymnasium", "tree")  # tree: dm_tree, which RLlib needs


class MissingPackageError(RlbenchError, RuntimeError):
    """A package of an optional extra is not installed."""


@dataclass(frozen=True)
class AppoSettings:
    """Settings of one training by APPO.

    Clip range, fragment length and gradient clipping as in the release of Scardigli et al. 2023.
    """

    joint_ratio: bool = False  # the literal recipe: one ratio for all pixels, one reward a frame
    learning_rate: float = 1e-3  # at the start; it falls linearly
    action_std: float = 0.3  # standard deviation of the action
    reach: int = 0  # pixels around one whose errors are credited to it
    price_weight: float = 1.0  # share of the price of samples that is charged
    multiplicative: bool = False  # does a step of the action multiply the density, or add to it?
    clip: float = 0.15  # of the probability ratio, around 1
    fragment_length: int = 4  # frames of an update
    env_runners: int = 0  # processes that act; 0: this one


def train(
    make_env: Callable[[], Env],
    make_sampler: Callable[[], nn.Module],
    frames: int,
    settings: AppoSettings = AppoSettings(),  # noqa: B008  (frozen)
    seed: int = 0,
    report_every: int = 500,
    on_progress: Callable[[int, nn.Module], None] = lambda frames, sampler: None,
) -> nn.Module:
    """A sampler trained by APPO for about `frames` frames.

    `on_progress(frames so far, sampler)` is called every `report_every` frames. Starting Ray takes
    about ten seconds; it is stopped afterwards, unless it was running before. Raises
    MissingPackageError without the extra `train`.
    """
    if missing := [name for name in NEEDED if importlib.util.find_spec(name) is None]:
        raise MissingPackageError(
            f"rllib-appo needs {', '.join(missing)}, which cannot be imported. Install it: "
            'pip install "rlbench[train]", or choose another learner: reinforce, critic, '
            "surrogate, gamma"
        )
    os.environ.update({name: os.environ.get(name, value) for name, value in QUIET_RAY.items()})
    import ray

    from methods.ours.policy.rllib import algorithm_config

    starts_ray = not ray.is_initialized()
    if starts_ray:
        ray.init(
            num_cpus=1 + settings.env_runners,
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            object_store_memory=256 * 2**20,
        )
    algorithm = None
    try:
        algorithm = algorithm_config(make_env, make_sampler, frames, settings, seed).build_algo()
        module, done, reported = algorithm.learner_group._learner.module[MODULE], 0, 0
        while done < frames:
            result = algorithm.train()
            done = int(result["env_runners"]["num_env_steps_sampled_lifetime"])
            if done // report_every > reported // report_every:
                reported = done
                on_progress(done, module.unwrapped().sampler)
        trained: nn.Module = module.unwrapped().sampler
        return trained
    finally:
        if algorithm is not None:
            algorithm.stop()
        if starts_ray:
            ray.shutdown()
