"""`ours` as a world: it walks the page, and any learner trains its sampler and nothing else."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from methods.ours.experiments.retrain_sampler import Task, retrain
from methods.ours.method import CARDS
from methods.ours.policy import LEARNERS, RLLIB, learner
from rlbench.ops.transfer import log_forward
from rlbench.run import unroll
from rlbench.weights import read_card
from tests.conftest import write_noise

SIDE = 32
HAS_RLLIB = all(importlib.util.find_spec(name) for name in ("ray", "gymnasium", "tree"))


@pytest.fixture
def task(tmp_path: Path) -> Task:
    folders = [write_noise(tmp_path / name, h=40, w=48, frames=3) for name in ("one", "two")]
    return Task(tuple(folders), crop=SIDE, length=3, seed=1)


def test_an_episode_of_mean_actions_is_the_page(task):
    world = task.world()
    drawn = torch.Generator().manual_seed(0)
    torch.nn.init.normal_(world.method.networks.sampler.last.weight, std=0.3, generator=drawn)
    world.reset()
    spp, clip = world.turn.spp, world.batches.draw(0)
    errors, over = [], False
    while not over:
        came = world.step(world.turn.act().detach())
        assert int(came.counts.sum()) == round(spp * SIDE**2)
        errors.append(came.errors)
        over = came.over
    with torch.no_grad():
        shown = list(unroll(world.method, clip, spp))
    assert len(shown) == len(errors) == 3
    for each, error in zip(shown, errors, strict=True):
        found, truth = (log_forward(x).clamp(0, 1) for x in (each.image, each.frame.reference.mean))
        assert torch.equal(error, (found - truth).square().mean(1, keepdim=True))


def test_episodes_follow_each_other_without_end(task):
    world = task.world()
    budgets = set()
    for _ in range(6):
        assert world.reset().shape == (1, *world.shape)
        budgets.add(world.turn.spp)
        assert world.turn.frame.index in (0, 1, 2)
    assert len(budgets) > 1


@pytest.mark.parametrize(
    "name",
    [
        *LEARNERS,
        pytest.param(
            RLLIB,
            marks=[
                pytest.mark.slow,
                pytest.mark.skipif(not HAS_RLLIB, reason="needs ray[rllib] and gymnasium"),
            ],
        ),
    ],
)
def test_every_learner_retrains_the_sampler_and_leaves_the_rest(name, task, tmp_path):
    floor = 0 if name == RLLIB else learner(name, 1).floor
    told = retrain(name, replace(task, floor=floor), 12, list(task.folders), tmp_path, "a command")
    assert set(told) == {"uniform", name}
    file = tmp_path / f"{name}.safetensors"
    before, after = load_file(CARDS / "ours.safetensors"), load_file(file)
    fresh = task.sampler().state_dict()
    for key, value in after.items():
        if not key.startswith("sampler."):
            assert torch.equal(value, before[key])
    assert after["sampler.last.weight"].abs().max() > 0 == fresh["last.weight"].abs().max()
    card, known = read_card(file), read_card(CARDS / "ours.safetensors").data
    assert card.origin == "encoder and denoiser of ours.safetensors"
    assert card.data == (*known, *task.batches().contents())


def test_a_clip_that_the_kept_networks_saw_too_is_told_once(task, tmp_path):
    retrain("ppo-pixel", task, 2, list(task.folders), tmp_path, "a command")
    first = tmp_path / "ppo-pixel.safetensors"
    again = replace(task, weights=first)
    retrain("surrogate", again, 2, list(task.folders), tmp_path, "a command")
    assert read_card(tmp_path / "surrogate.safetensors").data == read_card(first).data
