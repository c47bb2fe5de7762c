"""A frame problem: budgets are exact, rollouts repeat, and gradients reach the sampler."""

from __future__ import annotations

from functools import cache

import pytest
import torch

from methods.ours.frame_problem import FrameProblem
from methods.ours.policy import LEARNERS, make_learner
from methods.ours.policy.gamma_gradient import gamma_gradient_per_sample
from methods.ours.policy.surrogate_gradient import kuznetsov_gradient_per_sample
from methods.ours.train import training_task
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.run import unroll

CPU = torch.device("cpu")
SIZE = Size(1, 32, 48)


@cache
def second_frame(variant: str = "", spp: float = 2.0) -> FrameProblem:
    """The second frame of a clip, with a sampler that is not uniform."""
    method = training_task(variant, CPU, seed=0).method
    generator = torch.Generator().manual_seed(0)
    torch.nn.init.normal_(method.networks.sampler.last.weight, std=0.3, generator=generator)
    clip = procedural_clip(seed=2, size=SIZE, frames=2)
    first, second = clip
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


@pytest.mark.parametrize(("variant", "spp"), [("", 0.5), ("", 2.0), ("A1", 1.5), ("latent", 0.5)])
def test_counts_are_relaxed_counts_rounded_and_both_cost_the_budget(variant, spp):
    problem = second_frame(variant, spp)
    action = problem.act().detach()
    relaxed, rollout = problem.relaxed_counts(action), problem.rollout(action[None])
    assert float(relaxed.mean()) == pytest.approx(spp, rel=1e-4)
    assert (relaxed - rollout.counts[0]).abs().max() < 1.001  # rounded down or up


@pytest.mark.parametrize(
    "sample_gradient", [kuznetsov_gradient_per_sample, gamma_gradient_per_sample]
)
def test_a_gradient_reaches_the_sampler(sample_gradient):
    problem = second_frame("A1", 2.0)
    sampler = problem.method.networks.sampler
    sampler.zero_grad()
    problem.surrogate_loss(sample_gradient).backward()
    assert sampler.last.weight.grad.abs().max() > 0


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
        radiance = problem.frame.pool.read(problem.frame.pool.empty(), counts)
        samples = Samples(radiance, counts)
        image, _ = problem.method.denoise(problem.gbuffer, samples, problem.state)
        loss = image.square().mean()
        if weight:
            loss = loss + weight * learner.loss(problem, torch.Generator().manual_seed(0))
        return list(torch.autograd.grad(loss, others))

    counts = torch.full((1, 1, 32, 48), 2)
    for without, with_learner in zip(gradients(0.0), gradients(1.0), strict=True):
        assert torch.equal(without, with_learner)
    assert all(weight.requires_grad for weight in others)


def test_a_critic_observes_the_sampler_inputs():
    problem = second_frame()
    assert problem.observation.shape[1] == problem.method.networks.sampler_channels
    assert not problem.observation.requires_grad
