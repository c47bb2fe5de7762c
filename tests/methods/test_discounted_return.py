"""Discounted returns: a loop over frames is the oracle, and credit follows the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from methods.ours.episode_problem import EpisodeProblem, reward
from methods.ours.frame_problem import FrameProblem
from methods.ours.method import Ours
from methods.ours.policy.discounted_return import carry_back, discounted_return
from methods.ours.train import training_task
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.ops.reprojection import reproject
from rlbench.ops.transfer import log_forward
from rlbench.run import unroll
from rlbench.wrappers import MethodWrapper

SIZE = Size(1, 32, 32)
GAMMA = 0.9


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=torch.float64)


@settings(max_examples=20, deadline=None)
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
    method = training_task("paper", torch.device("cpu"), seed=0).method
    method.networks.eval()
    frames = list(procedural_clip(seed=2, size=SIZE, frames=3))
    problem = FrameProblem.of_frame(method, frames[0], method.start(SIZE), 2.0)
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
        lost = []
        for result in results:
            image, truth = (
                log_forward(x).clamp(0, 1) for x in (result.image, result.frame.reference.mean)
            )
            lost.append(10 - reward((image - truth).square().mean(1, keepdim=True))[None])
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
    actions = torch.cat(
        (torch.full((1, 1, 1, 32, 16), 1.0), torch.full((1, 1, 1, 32, 16), -1.0)), 4
    )
    both = torch.cat((actions, -actions))
    now = replace(problem, later=()).rollout(both).errors
    later = problem.rollout(both).errors - now
    assert later.min() >= 0
    assert (later[0] - later[1]).abs().max() > 1e-3
