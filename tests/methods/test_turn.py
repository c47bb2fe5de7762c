"""A turn of the sampler: budgets are exact, trials repeat, and slopes reach the sampler."""

from __future__ import annotations

from functools import cache

import pytest
import torch

from methods.ours.frame_problem import FrameProblem
from methods.ours.policy import LEARNERS
from methods.ours.policy.gamma_gradient import gamma_each
from methods.ours.policy.surrogate_gradient import pull_each
from methods.ours.train import trainer
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Samples, Size
from rlbench.run import unroll

CPU = torch.device("cpu")
SIZE = Size(1, 32, 48)


@cache
def turn(variant: str = "", spp: float = 2.0) -> FrameProblem:
    """The second frame of a clip, with a sampler that is not uniform."""
    method = trainer(variant, CPU, seed=0).method
    drawn = torch.Generator().manual_seed(0)
    torch.nn.init.normal_(method.networks.sampler.last.weight, std=0.3, generator=drawn)
    clip = procedural(seed=2, size=SIZE, frames=2)
    first, second = clip
    (shown,) = unroll(method, procedural(seed=2, size=SIZE, frames=1), spp)
    _, state = method.denoise(first.gbuffer, shown.samples, method.start(SIZE))
    return FrameProblem(method, second, second.gbuffer, state, spp)


@pytest.mark.parametrize(("variant", "spp"), [("", 0.5), ("", 2.0), ("A1", 1.5), ("A1", 4.0)])
def test_every_trial_costs_exactly_the_budget(variant, spp):
    asked = turn(variant, spp)
    actions = torch.rand(3, 1, 1, 32, 48, generator=torch.Generator().manual_seed(1)) * 2 - 1
    trial = asked.rollout(actions)
    assert trial.counts.sum((1, 2, 3, 4)).tolist() == [round(spp * 32 * 48)] * 3
    assert trial.counts.min() >= asked.method.traits.min_samples
    assert torch.equal(asked.rollout(actions).errors, trial.errors)


@pytest.mark.parametrize(("variant", "spp"), [("", 0.5), ("", 2.0), ("A1", 1.5)])
def test_relaxed_counts_cost_the_budget_and_are_what_counts_are_rounded_from(variant, spp):
    asked = turn(variant, spp)
    action = asked.act().detach()
    due, trial = asked.relaxed(action), asked.rollout(action[None])
    assert float(due.mean()) == pytest.approx(spp, rel=1e-4)
    assert (due - trial.counts[0]).abs().max() < 1.001  # rounded down or up


@pytest.mark.parametrize("teach", [pull_each, gamma_each])
def test_a_slope_reaches_the_sampler(teach):
    asked = turn("A1", 2.0)
    sampler = asked.method.networks.sampler
    sampler.zero_grad()
    asked.surrogate_loss(teach).backward()
    assert sampler.last.weight.grad.abs().max() > 0


@pytest.mark.parametrize("name", LEARNERS)
def test_every_learner_moves_the_sampler_of_ours_and_only_by_finite_steps(name):
    asked = turn("A1", 2.0)
    sampler = asked.method.networks.sampler
    sampler.zero_grad()
    learns = LEARNERS[name](asked.method.networks.foreseen)
    learns.loss(asked, torch.Generator().manual_seed(0)).backward()
    gradients = [p.grad for p in sampler.parameters() if p.grad is not None]
    assert all(torch.isfinite(gradient).all() for gradient in gradients)
    assert sampler.last.weight.grad.abs().max() > 0


@pytest.mark.parametrize("name", LEARNERS)
def test_a_learner_leaves_encoder_and_denoiser_to_the_image(name):
    asked = turn("A1", 2.0)
    networks, learns = asked.method.networks, LEARNERS[name](asked.method.networks.foreseen)
    others = [*networks.encoder.parameters(), *networks.denoiser.parameters()]

    def gradients(weight: float) -> list[torch.Tensor]:
        samples = asked.frame.pool.read(asked.frame.pool.empty(), counts)
        image, _ = asked.method.denoise(asked.gbuffer, Samples(samples, counts), asked.state)
        loss = image.square().mean()
        if weight:
            loss = loss + weight * learns.loss(asked, torch.Generator().manual_seed(0))
        return list(torch.autograd.grad(loss, others))

    counts = torch.full((1, 1, 32, 48), 2)
    for alone, beside in zip(gradients(0.0), gradients(1.0), strict=True):
        assert torch.equal(alone, beside)
    assert all(weight.requires_grad for weight in others)


def test_what_the_critic_sees_is_what_the_sampler_sees():
    asked = turn()
    assert asked.seen.shape[1] == asked.method.networks.foreseen
    assert not asked.seen.requires_grad
