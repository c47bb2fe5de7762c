"""Episodes of a sampler behind a frozen denoiser: they are the page `rlbench/run.py`."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from research.retrain_sampler import SamplerTask
from rlbench.run import unroll
from tests.conftest import write_noise
from tests.methods.test_problem import SIDE, pixel_errors


@pytest.fixture
def task(tmp_path: Path) -> SamplerTask:
    folders = [write_noise(tmp_path / name, h=40, w=48, frames=3) for name in ("one", "two")]
    return SamplerTask(tuple(folders), crop=SIDE, length=3, seed=1)


def test_an_episode_of_mean_actions_is_the_page(task):
    env = task.make_env()
    generator = torch.Generator().manual_seed(0)
    torch.nn.init.normal_(env.method.networks.sampler.last.weight, std=0.3, generator=generator)
    env.reset()
    spp, clip = env.problem.spp, env.batches.sequence(0)
    errors, truncated = [], False
    while not truncated:
        result = env.step(env.problem.act().detach())
        assert int(result.counts.sum()) == round(spp * SIDE**2)
        errors.append(result.errors)
        truncated = result.truncated
    with torch.no_grad():
        frames = list(unroll(env.method, clip, spp))
    assert len(frames) == len(errors) == 3
    for frame, error in zip(frames, errors, strict=True):
        assert torch.equal(error, pixel_errors(frame))


def test_episodes_follow_each_other_without_end(task):
    env = task.make_env()
    budgets = set()
    for _ in range(6):
        assert env.reset().shape == (1, *env.shape)
        budgets.add(env.problem.spp)
        assert env.problem.frame.index in (0, 1, 2)
    assert len(budgets) > 1
