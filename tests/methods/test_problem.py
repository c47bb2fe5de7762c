"""Frames and episodes as problems: exact budgets, returns against loops, gradients, episodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from methods.ours.method import Ours
from methods.ours.policy import LEARNERS, make_learner
from methods.ours.problem import EpisodeProblem, FrameProblem, carry_back, discounted_return, reward
from methods.ours.train import training_task
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.ops.reprojection import reproject
from rlbench.ops.transfer import log_forward
from rlbench.run import FrameResult, unroll
from rlbench.wrappers import MethodWrapper
from tests.baselines.noise import read_samples

CPU = torch.device("cpu")
SIZE = Size(1, 32, 48)
SQUARE = Size(1, 32, 32)
GAMMA = 0.9
SIDE = 32


def pixel_errors(result: FrameResult) -> torch.Tensor:
    """Squared error of each pixel in log transfer."""
    image, truth = (log_forward(x).clamp(0, 1) for x in (result.image, result.frame.reference.mean))
    return (image - truth).square().mean(1, keepdim=True)


@cache
def second_frame(variant: str = "", spp: float = 2.0) -> FrameProblem:
    """The second frame of a clip, with a sampler that is not uniform."""
    method = training_task(variant, CPU, seed=0).method
    generator = torch.Generator().manual_seed(0)
    torch.nn.init.normal_(method.networks.sampler.last.weight, std=0.3, generator=generator)
    first, second = procedural_clip(seed=2, size=SIZE, frames=2)
    (result,) = unroll(method, procedural_clip(seed=2, size=SIZE, frames=1), spp)
    _, state = method.denoise(first.gbuffer, result.samples, method.start(SIZE))
    return FrameProblem(method, second, second.gbuffer, state, spp)


@pytest.mark.parametrize(
    ("variant", "spp"), [("", 0.5), ("", 2.0), ("A1", 1.5), ("A1", 4.0), ("latent", 0.5)]
)
def test_every_rollout_costs_exactly_the_budget_and_repeats(variant, spp):
    problem = second_frame(variant, spp)
    actions = torch.rand(3, 1, 1, 32, 48, generator=torch.Generator().manual_seed(1)) * 2 - 1
    rollout = problem.rollout(actions)
    assert rollout.counts.sum((1, 2, 3, 4)).tolist() == [round(spp * 32 * 48)] * 3
    assert rollout.counts.min() >= problem.method.traits.min_samples
    assert torch.equal(problem.rollout(actions).errors, rollout.errors)
    relaxed = problem.relaxed_counts(actions[0])
    assert float(relaxed.mean()) == pytest.approx(spp, rel=1e-4)
    assert (relaxed - rollout.counts[0]).abs().max() < 1.001  # rounded down or up


def test_a_density_of_zeros_is_uniform_and_has_a_finite_gradient():
    problem = second_frame("paper-A1")
    action = torch.full((1, 1, 32, 48), -1.0, requires_grad=True)
    relaxed = problem.relaxed_counts(action)
    torch.testing.assert_close(relaxed, torch.full_like(relaxed, problem.spp))
    relaxed[..., 0].sum().backward()
    assert action.grad.eq(0).all()


@pytest.mark.parametrize("variant", ["A1", "latent-A1"])
@pytest.mark.parametrize("name", LEARNERS)
def test_every_learner_moves_the_sampler_of_ours_and_only_by_finite_steps(name, variant):
    problem = second_frame(variant, 2.0)
    sampler = problem.method.networks.sampler
    sampler.zero_grad()
    learner = make_learner(name, problem.method.networks.sampler_channels)
    learner.loss(problem, torch.Generator().manual_seed(0)).backward()
    gradients = [p.grad for p in sampler.parameters() if p.grad is not None]
    assert all(torch.isfinite(gradient).all() for gradient in gradients)
    assert sampler.last.weight.grad.abs().max() > 0


@pytest.mark.parametrize("name", LEARNERS)
def test_a_learner_leaves_encoder_and_denoiser_to_the_image(name):
    problem = second_frame("latent-A1", 2.0)
    networks = problem.method.networks
    learner = make_learner(name, networks.sampler_channels)
    others = [*networks.encoder.parameters(), *networks.denoiser.parameters()]

    def gradients(weight: float) -> list[torch.Tensor]:
        samples = read_samples(problem.frame, 2)
        image, _ = problem.method.denoise(problem.gbuffer, samples, problem.state)
        loss = image.square().mean()
        if weight:
            loss = loss + weight * learner.loss(problem, torch.Generator().manual_seed(0))
        return list(torch.autograd.grad(loss, others))

    for without, with_learner in zip(gradients(0.0), gradients(1.0), strict=True):
        assert torch.equal(without, with_learner)
    assert all(weight.requires_grad for weight in others)


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=torch.float64)


@settings(max_examples=20)
@given(frames=st.integers(1, 6), gamma=st.floats(0, 1), seed=st.integers(0, 99))
def test_without_motion_the_return_is_the_discounted_sum(frames, gamma, seed):
    rewards = random(frames, 2, 1, 1, 4, 5, seed=seed)
    expected = sum(gamma**t * rewards[t] for t in range(frames))
    result = discounted_return(list(rewards), [None] * (frames - 1), gamma)
    torch.testing.assert_close(result, expected)


@pytest.mark.parametrize("seed", range(4))
def test_carrying_back_is_the_transpose_of_reprojection(seed):
    """Equal inner products, for any motion, also out of the image."""
    motion = 3 * random(2, 2, 7, 9, seed=seed)
    values, history = random(3, 2, 1, 7, 9, seed=seed + 10), random(2, 3, 7, 9, seed=seed + 20)
    moved, valid = reproject(history, motion)
    forward = (moved * valid * values.squeeze(2).transpose(0, 1)).sum()
    back = (carry_back(values, motion).squeeze(2).transpose(0, 1) * history).sum()
    torch.testing.assert_close(back, forward)
    assert not valid.all()


def test_a_later_reward_counts_where_its_history_came_from():
    later = torch.arange(1.0, 6.0).view(1, 1, 1, 1, 5)
    motion = torch.tensor([2.0, 0.0]).view(1, 2, 1, 1).expand(1, 2, 1, 5)  # from 2 pixels right
    result = discounted_return([torch.zeros_like(later), later], [motion], 0.5)
    assert result.flatten().tolist() == [0, 0, 0.5, 1.0, 1.5]  # 4 and 5 have no history


@dataclass(frozen=True)
class FirstAction(MethodWrapper[Ours]):
    """A given action in the first frame, mean actions after it."""

    action: torch.Tensor

    def plan(self, gbuffer, samples, state):
        if state.age:
            return self.method.plan(gbuffer, samples, state)
        return self.method.to_density(self.action, gbuffer, state)


@pytest.fixture(scope="module")
def episode() -> tuple[EpisodeProblem, InMemoryClip]:
    """The first of three frames of a clip with motion."""
    method = training_task("paper", CPU, seed=0).method
    method.networks.eval()
    frames = list(procedural_clip(seed=2, size=SQUARE, frames=3))
    problem = FrameProblem.of_frame(method, frames[0], method.start(SQUARE), 2.0)
    clip = InMemoryClip("three", "frames", "", frames)
    return EpisodeProblem.of_problem(problem, frames[1:], GAMMA), clip


def test_a_rollout_walks_the_page_to_the_end_of_the_episode(episode):
    problem, clip = episode
    actions = torch.rand(2, 1, 1, 32, 32, generator=torch.Generator().manual_seed(1)) * 2 - 1
    rollout = problem.rollout(actions)
    for action, costs, counts in zip(actions, rollout.errors, rollout.counts, strict=True):
        with torch.no_grad():
            results = list(unroll(FirstAction(problem.method, action), clip, 2.0))
        assert torch.equal(counts, results[0].samples.counts.float())
        lost = [10 - reward(pixel_errors(result))[None] for result in results]
        motions = [frame.gbuffer.motion for frame in problem.later]
        expected = discounted_return(lost, motions, GAMMA)[0]
        torch.testing.assert_close(costs, expected, rtol=1e-5, atol=1e-6)


def test_with_a_discount_of_zero_only_this_frame_counts(episode):
    problem = replace(episode[0], gamma=0.0)
    actions = torch.zeros(2, 1, 1, 32, 32)
    frame = FrameProblem.of_frame(problem.method, problem.frame, problem.state, problem.spp)
    expected = 10 - reward(frame.rollout(actions).errors)
    torch.testing.assert_close(problem.rollout(actions).errors, expected)


def test_a_later_gain_is_credited_to_the_samples_that_led_to_it(episode):
    """What a map changes in later frames through the state is part of its return."""
    problem, _ = episode
    actions = torch.where(torch.arange(32) < 16, 1.0, -1.0).expand(1, 1, 1, 32, 32)
    both = torch.cat((actions, -actions))
    now = replace(problem, later=()).rollout(both).errors
    later = problem.rollout(both).errors - now
    assert later.min() >= 0
    assert (later[0] - later[1]).abs().max() > 1e-3
