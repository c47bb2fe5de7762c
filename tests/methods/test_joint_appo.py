"""One policy over the image: V-trace and loss against loops, and a problem that it can learn."""

from __future__ import annotations

import importlib.util
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from methods.ours.policy.joint_appo import JointAppo, Trajectory, vtrace
from methods.ours.train import ActingMethod, episode_losses, training_task
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size

CPU = torch.device("cpu")
FRAMES, CHANNELS, SIDE = 3, 5, 16


class OneLayer(nn.Module):
    """A sampler of one layer."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Conv2d(CHANNELS, 1, 1)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.layer(inputs))


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@settings(max_examples=30)
@given(
    frames=st.integers(1, 6),
    gamma=st.floats(0, 1),
    spread=st.sampled_from([0.0, 0.5, 5.0]),
    seed=st.integers(0, 99),
)
def test_vtrace_is_the_sum_of_its_definition(frames, gamma, spread, seed):
    """Espeholt et al. 2018, equation 1, term by term."""
    log_ratio, rewards, values = random(3, frames, 1, seed=seed).double()
    targets, gain = vtrace(spread * log_ratio, rewards, values, gamma)
    ratio = [min(1.0, math.exp(spread * float(x))) for x in log_ratio]
    value = [float(x) for x in values] + [0.0]
    error = [
        ratio[t] * (float(rewards[t]) + gamma * value[t + 1] - value[t]) for t in range(frames)
    ]
    expected = [
        value[s]
        + sum(gamma ** (t - s) * math.prod(ratio[s:t]) * error[t] for t in range(s, frames))
        for s in range(frames)
    ] + [0.0]
    assert targets.flatten().tolist() == pytest.approx(expected[:-1])
    assert gain.flatten().tolist() == pytest.approx(
        [ratio[s] * (float(rewards[s]) + gamma * expected[s + 1] - value[s]) for s in range(frames)]
    )


@pytest.mark.slow
@pytest.mark.skipif(
    not all(importlib.util.find_spec(name) for name in ("ray", "gymnasium", "tree")),
    reason="needs ray[rllib] and gymnasium",
)
def test_vtrace_is_that_of_rllib():
    from ray.rllib.algorithms.impala.torch.vtrace_torch_v2 import vtrace_torch

    delayed, acted, rewards, values = random(4, 6, 2)
    discounts = torch.full((6, 2), 0.99)
    discounts[-1] = 0  # the episode terminates
    expected = vtrace_torch(
        target_action_log_probs=delayed,
        behaviour_action_log_probs=acted,
        discounts=discounts,
        rewards=rewards,
        values=values,
        bootstrap_values=torch.zeros(2),
    )
    for ours, theirs in zip(vtrace(delayed - acted, rewards, values, 0.99), expected, strict=True):
        torch.testing.assert_close(ours, theirs)


@pytest.fixture
def learner() -> JointAppo:
    torch.manual_seed(0)
    return JointAppo.of_sampler(OneLayer(), CHANNELS, gamma=0.9)


def act(learner: JointAppo, observations: torch.Tensor, seed: int) -> list[torch.Tensor]:
    """Mean actions, and actions that the learner draws."""
    generator = torch.Generator().manual_seed(seed)
    acts = [learner.act(observation, generator) for observation in observations]
    return [torch.stack(part) for part in zip(*acts, strict=True)]


def trajectory(learner: JointAppo) -> Trajectory:
    """What the learner's sampler does in random frames, for random rewards."""
    observations = random(FRAMES, 1, CHANNELS, SIDE, SIDE, seed=2)
    rewards = random(FRAMES, 1, seed=3).abs()
    return Trajectory(observations, *act(learner, observations, 1), rewards)


@pytest.mark.parametrize("step", [0.0, 0.002, 0.2])
def test_the_loss_is_that_of_a_loop_over_frames(learner, step):
    """After a step of the sampler, ratios are joint over the image, and clipped."""
    episode = trajectory(learner)
    with torch.no_grad():
        learner.sampler.layer.bias += step
        learner.network.delayed.layer.bias -= 0.3 * step

    def log_probability(mean: torch.Tensor, frame: int) -> float:
        difference = (episode.actions[frame] - mean).double()
        return float(-difference.square().sum() / 2 / learner.action_std**2)

    with torch.no_grad():
        acted, now, delayed = (
            [log_probability(means[t], t) for t in range(FRAMES)]
            for means in (
                episode.means,
                [learner.sampler(o) for o in episode.observations],
                [learner.network.delayed(o) for o in episode.observations],
            )
        )
        values = learner.network.values(episode.observations)
    log_ratio = torch.tensor(delayed) - torch.tensor(acted)
    targets, gain = vtrace(log_ratio[:, None], episode.rewards, values, 0.9)
    total = 0.0
    for t in range(FRAMES):
        ratio = min(math.exp(acted[t] - delayed[t]), 2.0) * math.exp(min(now[t] - acted[t], 20.0))
        clipped = min(max(ratio, 1 - learner.clip), 1 + learner.clip)
        total -= min(ratio * float(gain[t]), clipped * float(gain[t])) / FRAMES
        total += 0.5 * (float(values[t]) - float(targets[t])) ** 2 / 2 / FRAMES
    assert float(learner.loss(episode).detach()) == pytest.approx(total, rel=1e-3)


def test_the_loss_stays_finite_where_a_joint_ratio_overflows(learner):
    episode = trajectory(learner)
    with torch.no_grad():
        learner.sampler.layer.bias += 3 * (episode.actions - episode.means).mean().sign()
    loss = learner.loss(episode._replace(actions=episode.actions + 5))
    loss.backward()
    assert loss.isfinite()
    assert all(p.grad.isfinite().all() for p in learner.sampler.parameters())


def test_the_delayed_sampler_follows_every_second_episode(learner):
    def delay() -> float:
        return float((learner.sampler.layer.bias - learner.network.delayed.layer.bias).detach())

    delays = []
    for _ in range(4):
        learner.begin_episode()
        with torch.no_grad():
            learner.sampler.layer.bias += 1
        delays.append(delay())
    assert delays == [1, 2, 1, 2]


def test_it_learns_where_few_pixels_share_a_reward(learner):
    """An image of 2x2 pixels: the ratio stays in the clip range, and the reward means something."""
    parameters = [*learner.sampler.parameters(), *learner.network.value.parameters()]
    adam = torch.optim.Adam(parameters, 3e-3)
    observations = random(1, CHANNELS, 2, 2).expand(8, 1, -1, -1, -1)
    target = torch.tensor([0.6, -0.6, 0.6, -0.6])

    def error() -> float:
        mean = learner.sampler(observations[0]).detach().flatten()
        return float((mean - target).square().mean())

    before = error()
    for number in range(400):
        learner.begin_episode()
        means, actions = act(learner, observations, number)
        rewards = 1 - (actions.flatten(1) - target).square().mean(1, keepdim=True)
        episode = Trajectory(observations, means, actions, rewards)
        for _ in range(learner.passes):
            adam.zero_grad()
            learner.loss(episode).backward()
            adam.step()
    assert error() < before / 2


@pytest.fixture(scope="module")
def acting() -> ActingMethod:
    method = training_task("paper-appo", CPU, seed=0).method
    networks = method.networks
    learner = JointAppo.of_sampler(networks.sampler, networks.sampler_channels, 0.99)
    return ActingMethod(method, learner, torch.Generator())


def test_rewards_and_actions_of_an_episode_are_those_of_the_paper(acting):
    clip = procedural_clip(seed=1, size=Size(2, 32, 32), frames=3)
    losses = [loss.detach() for loss in episode_losses(acting)(clip, 2.0)]
    assert len(losses) == 3 + acting.learner.passes
    episode = acting.trajectory([torch.zeros(2)] * 3)
    assert episode.observations.shape == (3, 2, 39, 32, 32)
    noise = (episode.actions - episode.means) / acting.learner.action_std
    assert float(noise.std()) == pytest.approx(1, abs=0.05)
    assert float((noise[0] * noise[1]).mean()) == pytest.approx(0, abs=0.1)


def test_the_sampler_learns_from_episodes_alone_and_the_others_from_images(acting):
    networks = acting.method.networks
    clip = procedural_clip(seed=1, size=Size(1, 32, 32), frames=2)
    learned = []
    for loss in episode_losses(acting)(clip, 2.0):
        networks.zero_grad()
        loss.backward()
        weights = networks.named_parameters()
        with_gradient = [k for k, p in weights if p.grad is not None and p.grad.any()]
        learned.append({name.partition(".")[0] for name in with_gradient})
    assert learned == [{"encoder", "denoiser"}] * 2 + [{"sampler"}] * acting.learner.passes


def test_a_reward_is_ten_to_the_power_of_one_minus_the_loss(acting, monkeypatch):
    rewards = []
    monkeypatch.setattr(
        ActingMethod, "trajectory", lambda self, given: rewards.extend(given) or None
    )
    monkeypatch.setattr(JointAppo, "loss", lambda self, episode: torch.zeros(()))
    clip = procedural_clip(seed=1, size=Size(1, 32, 32), frames=2)
    losses = [float(loss.detach()) for loss in episode_losses(acting)(clip, 2.0)]
    assert [float(r) for r in rewards] == pytest.approx([10 ** (1 - loss) for loss in losses[:2]])
