"""Training `ours`: its first weights, its losses, and the gradients that reach the networks."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from baselines.accumulate.density import contrast as contrast_of
from baselines.accumulate.density import mix_with_uniform
from baselines.oidn.method import Oidn
from methods.ours import LATENT, TRAITS, VARIANTS, Config
from methods.ours.history import gbuffer_features
from methods.ours.method import assemble
from methods.ours.policy import BlockReinforce
from methods.ours.problem import EpisodeProblem
from methods.ours.train import config_task, training_task
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.ops.init import kaiming_init
from rlbench.ops.losses import l1_ms_ssim_loss
from rlbench.ops.transfer import log_forward
from rlbench.run import run_clip, unroll
from tests.baselines.noise import read_samples

CPU = torch.device("cpu")
FROM_INTEL = [
    variant
    for variant, config in VARIANTS.items()
    if config.accumulation != "none" and config.denoiser_start == "intel"
]


def test_a_step_has_the_same_length_at_a_large_loss_as_at_a_small_one():
    """The gradient is that of the loss over the loss: equal decibels count equally."""
    task = training_task("A2", CPU, seed=0)
    clip = procedural_clip(seed=3, size=Size(1, 32, 32), frames=1)
    ((loss,), (result,)) = task.losses(clip, 1.0), unroll(task.method, clip, 1.0)
    plain = l1_ms_ssim_loss(log_forward(result.image), log_forward(result.frame.reference.mean))
    weights = list(task.networks.parameters())
    of_loss = torch.autograd.grad(loss, weights, allow_unused=True)
    of_plain = torch.autograd.grad(plain, weights, allow_unused=True)
    factor = 0.02 / plain.item()
    for gradient, expected in zip(of_loss, of_plain, strict=True):
        assert (gradient is None) == (expected is None)
        if gradient is not None:
            torch.testing.assert_close(gradient, expected * factor, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("variant", FROM_INTEL)
def test_training_starts_with_the_image_of_open_image_denoise(variant):
    """In the first frame no radiance is accumulated, and the weights of the state are zero."""
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.extract import load_network

    method = training_task(variant, CPU, seed=0).method
    method.networks.eval()
    clip = procedural_clip(seed=3, size=Size(1, 48, 64), frames=1)
    (result,) = run_clip(replace(method, sampler=None), clip, 2.0)
    intel = Oidn(load_network(VARIANTS[variant].denoiser))
    expected, _ = intel.denoise(result.frame.gbuffer, result.samples, None)
    # sums in another order, and the exposure is of the same image
    torch.testing.assert_close(result.image, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("variant", "rule"), [("", True), ("latent", False)])
def test_an_untrained_sampler_is_uniform_and_later_leaves_frames_to_the_rule(variant, rule):
    method, size = training_task(variant, CPU, seed=0).method, Size(1, 32, 48)
    first, second = procedural_clip(seed=1, size=size, frames=2)
    samples, start = read_samples(first, 2), method.start(size)
    assert method.plan(first.gbuffer, first.pool.empty(), start).unique().numel() == 1
    with torch.no_grad():
        _, state = method.denoise(first.gbuffer, samples, start)
        density = method.plan(second.gbuffer, samples, state)
        history = method.reproject(second.gbuffer, state)
    by_rule = mix_with_uniform(contrast_of(history), history.similarity)
    torch.testing.assert_close(density, by_rule if rule else torch.ones_like(density))
    assert by_rule.unique().numel() > 1000


def contrast(config: Config, steps: int = 6) -> float:
    """Mean absolute action after steps of Adam towards random actions, at the rate of a config."""
    task, generator = config_task(config, TRAITS, CPU, seed=0), torch.Generator().manual_seed(0)
    sampler = task.networks.sampler
    adam = torch.optim.Adam(sampler.parameters(), task.max_lr * task.lr_multipliers["sampler"])
    inputs = torch.rand(1, task.networks.sampler_channels, 16, 16, generator=generator)
    target = torch.rand(1, 1, 16, 16, generator=generator) * 2 - 1
    for _ in range(steps):
        adam.zero_grad()
        (-sampler(inputs) * target).mean().backward()
        adam.step()
    return float(sampler(inputs).detach().abs().mean())


def test_steps_change_the_map_of_a_wider_sampler_no_further():
    """At the full rate six steps end at 0.91, with nearly all of the map at its bounds."""
    assert 0 < contrast(replace(LATENT, sampler=(64, 128, 256, 512, 1024))) <= contrast(LATENT)


@pytest.mark.parametrize("variant", [name for name in VARIANTS if name.startswith("paper")])
def test_in_the_papers_recipe_sampler_and_denoiser_start_from_random_weights(variant):
    """The last layer of the sampler is zero; nothing is wired to contrast."""
    networks, random = (training_task(variant, CPU, seed=3).networks for _ in range(2))
    kaiming_init(random, 3)
    if random.sampler is not None:
        random.sampler.start_uniform()
    expected = random.state_dict()
    for name, weight in networks.state_dict().items():
        assert name.startswith("encoder.") or torch.equal(weight, expected[name])


@pytest.mark.parametrize("variant", ["", "latent", "latent-B1"])
def test_the_last_layer_of_an_untrained_sampler_reads_contrast_in_the_previous_frame(variant):
    """Contrast in its image, or its samples."""
    method = training_task(variant, CPU, seed=0).method
    outputs: list[Tensor] = []
    method.networks.sampler.head.register_forward_hook(lambda layer, x, out: outputs.append(out))
    clip = procedural_clip(seed=1, size=Size(1, 64, 64), frames=1)
    (frame,) = clip
    noise = torch.rand(1, 1, 64, 32, generator=torch.Generator().manual_seed(0)) - 0.5
    state = replace(method.start(clip.size), age=1)
    state.features[:] = 0.1
    state.features[:, :3, :, 32:] += 0.2 * noise
    if method.config.accumulates:
        state.gbuffer_features[:] = gbuffer_features(frame.gbuffer)  # else there was a cut
        state.image[:] = 0.5
        state.image[..., 32:] += noise
    with torch.no_grad():
        method.act(replace(frame.gbuffer, static=True), state)
    contrast = F.interpolate(outputs[0], size=(64, 64))[0, 0]  # of `ours` at half resolution
    assert contrast[8:-8, 40:-8].mean() > contrast[8:-8, 8:24].mean() + 0.2


@pytest.mark.parametrize("variant", ["", "latent"])
def test_every_network_gets_a_gradient_from_one_sequence(variant):
    task = training_task(variant, CPU, seed=0)
    kaiming_init(task.networks, 0)
    clip = procedural_clip(seed=1, size=Size(2, 32, 32), frames=2)
    for loss in task.losses(clip, 2.0):
        loss.backward()
    without = [k for k, p in task.networks.named_parameters() if p.grad is None or not p.grad.any()]
    # biases of dead units may be untouched, but no whole layer may be
    assert not [name for name in without if name.endswith("weight")]


def test_the_papers_recipe_credits_a_map_with_the_rest_of_its_episode(monkeypatch):
    """Each problem gets the frames after its own."""
    problems: list[EpisodeProblem] = []
    learn = BlockReinforce.loss

    def record(self, problem, generator):
        problems.append(problem)
        return learn(self, problem, generator)

    monkeypatch.setattr(BlockReinforce, "loss", record)
    task = training_task("paper", CPU, seed=0)
    clip = procedural_clip(seed=1, size=Size(1, 32, 32), frames=3)
    assert len(list(task.losses(clip, 2.0))) == 3
    following = [[frame.index for frame in problem.later] for problem in problems]
    assert following == [[1, 2], []]
    assert {problem.gamma for problem in problems} == {0.99}


@pytest.mark.parametrize(("variant", "carrier"), [("", "image"), ("latent", "features")])
@pytest.mark.parametrize("bptt", [1, 2])
def test_the_state_carries_a_gradient_over_bptt_frames(bptt, variant, carrier):
    method = training_task(variant, CPU, seed=0).method
    method = assemble(replace(method.config, bptt=bptt), method.traits, method.networks)
    (frame,) = procedural_clip(seed=1, size=Size(1, 32, 32), frames=1)
    _, state = method.denoise(frame.gbuffer, frame.pool.empty(), method.start(frame.pool.size))
    carried = getattr(state, carrier)
    assert carried.requires_grad
    carried.retain_grad()
    image, _ = method.denoise(frame.gbuffer, frame.pool.empty(), state)
    image.sum().backward()
    assert (carried.grad is None) == (bptt == 1)


@pytest.mark.parametrize(("bptt", "steps"), [(1, 3), (2, 2)])
def test_a_step_is_taken_every_bptt_frames(bptt, steps, monkeypatch):
    monkeypatch.setitem(VARIANTS, "", replace(VARIANTS[""], bptt=bptt))
    task = training_task("", CPU, seed=0)
    clip = procedural_clip(seed=1, size=Size(1, 32, 32), frames=3)
    taken = 0
    for loss in task.losses(clip, 2.0):
        loss.backward()
        taken += 1
    assert taken == steps
