"""The paper's own tool: APPO of Ray RLlib around a world, in one process or on many machines."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable

from torch import nn

from methods.ours.policy.appo_config import Appo
from methods.ours.policy.environment import Env
from rlbench.errors import RlbenchError
from rlbench.parallel.ray_executor import QUIET

NEEDED = ("ray", "gymnasium", "tree")  # tree: dm_tree, which RLlib needs


class MissingError(RlbenchError, RuntimeError):
    """An extra is not installed."""


def train(
    world: Callable[[], Env],
    sampler: Callable[[], nn.Module],
    frames: int,
    settings: Appo = Appo(),  # noqa: B008  (frozen)
    seed: int = 0,
    every: int = 500,
    report: Callable[[int, nn.Module], None] = lambda frames, sampler: None,
) -> nn.Module:
    """A sampler trained by APPO for about `frames` frames; `report` is told every so many.

    Starting Ray takes some ten seconds; it is stopped again, unless it was running. Raises
    MissingError where an extra is not installed.
    """
    if missing := [name for name in NEEDED if not _installed(name)]:
        raise MissingError(
            f"rllib-appo needs {', '.join(missing)}, which cannot be imported here; "
            'pip install "rlbench[train]", or train by: ppo-pixel, critic, surrogate, gamma'
        )
    os.environ.update({name: os.environ.get(name, value) for name, value in QUIET.items()})
    from methods.ours.policy import rllib

    return rllib.train(world, sampler, frames, settings, seed, every, report)


def _installed(name: str) -> bool:
    return importlib.util.find_spec(name) is not None
