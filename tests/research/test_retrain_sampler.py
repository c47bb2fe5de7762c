"""Training the sampler alone, in episodes behind a frozen denoiser: nothing else changes."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from methods.ours.method import CARDS
from methods.ours.policy import LEARNERS, RLLIB_APPO, make_learner
from research import retrain_sampler
from research.retrain_sampler import SamplerTask, retrain
from rlbench.run import unroll
from rlbench.weights import read_card
from tests.conftest import write_noise
from tests.methods.test_problem import SIDE, pixel_errors

NEEDS_RLLIB = pytest.mark.skipif(
    not all(importlib.util.find_spec(name) for name in ("ray", "gymnasium", "tree")),
    reason="needs ray[rllib] and gymnasium",
)
QUICK = ("reinforce", "critic")  # which has a network of its own


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
    assert len(frames) == 3
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


@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in LEARNERS),
        pytest.param(RLLIB_APPO, marks=[pytest.mark.slow, NEEDS_RLLIB]),
    ],
)
def test_every_learner_retrains_the_sampler_and_leaves_the_rest(name, task, tmp_path):
    min_samples = 0 if name == RLLIB_APPO else make_learner(name, 1).min_samples
    task = replace(task, min_samples=min_samples)
    psnr = retrain(name, task, 12, list(task.folders), tmp_path, "a command")
    assert set(psnr) == {"untrained", name}
    file = tmp_path / f"{name}.safetensors"
    before, after = load_file(CARDS / "ours.safetensors"), load_file(file)
    initial = task.make_sampler().state_dict()
    for key, value in after.items():
        if not key.startswith("sampler."):
            assert torch.equal(value, before[key])
    assert after["sampler.last.weight"].abs().max() > 0 == initial["last.weight"].abs().max()
    card, known = read_card(file), read_card(CARDS / "ours.safetensors").data
    assert card.origin == "all but the sampler of ours.safetensors"
    assert card.data == (*known, *task.make_batches().clip_digests())


@pytest.mark.slow
@NEEDS_RLLIB
def test_rllib_trains_the_papers_sampler_by_one_policy(task, tmp_path):
    task = replace(task, weights=CARDS / "paper.safetensors", variant="paper", one_policy=True)
    retrain(RLLIB_APPO, task, 12, list(task.folders), tmp_path, "a command")
    file = tmp_path / f"{RLLIB_APPO}.safetensors"
    initial = task.make_sampler().state_dict()["last.weight"]
    assert load_file(file)["sampler.last.weight"].abs().max() > 0 == initial.abs().max()
    card = read_card(file)
    assert card.name == "ours/paper"
    assert card.note == "sampler alone, by rllib-appo, one policy over the image"


def test_a_sampler_of_the_papers_recipe_is_retrained_behind_its_own_networks(task, tmp_path):
    task = replace(task, weights=CARDS / "paper.safetensors", variant="paper")
    retrain("reinforce", task, 2, list(task.folders), tmp_path, "a command")
    before, after = (load_file(file) for file in (task.weights, tmp_path / "reinforce.safetensors"))
    kept = [key for key in before if not key.startswith("sampler.")]
    assert all(torch.equal(before[key], after[key]) for key in kept)
    names = [replace(task, min_samples=least).scored_as for least in (0, 1)]
    assert names == ["ours/paper", "ours/paper-A1"]


@pytest.mark.slow
def test_a_clip_that_the_kept_networks_saw_too_is_listed_once(task, tmp_path):
    retrain("reinforce", task, 2, list(task.folders), tmp_path, "a command")
    first = tmp_path / "reinforce.safetensors"
    again = replace(task, weights=first)
    retrain("surrogate", again, 2, list(task.folders), tmp_path, "a command")
    assert read_card(tmp_path / "surrogate.safetensors").data == read_card(first).data


def test_the_command_writes_weights_with_a_card_and_prints_their_score(
    tmp_path, monkeypatch, capsys
):
    clips, out = tmp_path / "clips", tmp_path / "out"
    for name in ("one", "two", "three"):
        write_noise(clips / name, h=40, w=48, frames=3)
    words = f"x --by reinforce --frames 2 --crop 32 --clips {clips} --out {out}"
    monkeypatch.setattr(sys, "argv", words.split())
    retrain_sampler.main()
    assert {file.name for file in out.iterdir()} == {"reinforce.safetensors", "reinforce.toml"}
    assert read_card(out / "reinforce.safetensors").note == "sampler alone, by reinforce"
    assert "reinforce: " in capsys.readouterr().out
