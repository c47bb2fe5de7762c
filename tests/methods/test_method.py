"""The proposed method: network sizes, variants, history, and the first steps of training."""

from __future__ import annotations

import json
import math
import weakref
from dataclasses import asdict, replace

import pytest
import torch
from torch import Tensor, nn

from baselines.oidn.method import Oidn
from methods.ours import FAMILY
from methods.ours.method import CARDS, assemble, build
from methods.ours.networks import Encoder, Networks, Sampler
from methods.ours.state import gbuffer_features
from methods.ours.train import training_task
from methods.ours.variants import BASE, SLOTS, VARIANTS
from rlbench import registry
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Frame, GBuffer, Samples, Size
from rlbench.ops.init import kaiming_init
from rlbench.ops.losses import l1_ms_ssim_loss
from rlbench.ops.transfer import log_forward
from rlbench.run import run_clip, unroll
from rlbench.weights import read_card

CPU = torch.device("cpu")


GBUFFER = next(iter(procedural(seed=3, size=Size(1, 32, 32), frames=1))).gbuffer


def parameters(network: nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


@pytest.mark.parametrize(
    ("network", "count"),
    [
        (Networks(VARIANTS["paper"]).sampler, 31_101),
        (Networks(VARIANTS["paper"]).encoder, 54_816),
        (Networks(VARIANTS["paper"]).denoiser, 939_683),
        (Encoder(63, (64,), 32, 1), 6_176),  # 1x1 kernels, as in the release
        (Sampler(39, VARIANTS["small"].sampler), 486 - 19),  # the release has two outputs
    ],
    ids=["sampler", "encoder", "denoiser", "small encoder", "small sampler"],
)
def test_parameter_counts_are_those_of_the_fact_sheet(network, count):
    assert parameters(network) == count


def test_a_step_has_the_same_length_at_a_large_loss_as_at_a_small_one():
    """The gradient is that of the loss over the loss: equal decibels count equally."""
    task = training_task("A2", CPU, seed=0)
    clip = procedural(seed=3, size=Size(1, 32, 32), frames=1)
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


@pytest.mark.parametrize(
    ("variant", "fields"),
    [
        ("", set()),
        ("paper", {"accumulation", "density", "log_loss", "learner"}),
        ("A1", {"learner"}),
        ("A2", {"sampler"}),
        ("B1", {"encoder", "history_mode", "accumulation"}),
        ("B2", {"encoder", "history_mode", "accumulation"}),
        ("C", {"sample_encoding"}),
        ("reinforce", {"learner"}),
        ("C+count", {"sample_encoding"}),
        ("small", {"sampler", "encoder_kernel", "denoiser"}),
        ("flat", {"ignore_density"}),
        ("lag", {"antilag"}),
        ("sampler-small", {"sampler"}),
        ("sampler-large", {"sampler"}),
        ("encoder-small", {"encoder_kernel"}),
        ("encoder-large", {"encoder"}),
        ("denoiser-small", {"denoiser"}),
        ("denoiser-large", {"denoiser"}),
    ],
)
def test_a_variant_changes_only_what_its_row_claims(variant, fields):
    base, other = asdict(BASE), asdict(VARIANTS[variant])
    assert {name for name in base if base[name] != other[name]} == fields


def test_the_table_and_the_family_name_the_same_variants():
    assert list(VARIANTS) == list(FAMILY.variants)


@pytest.mark.parametrize("variant", [v for v in VARIANTS if v not in ("paper", "denoiser-large")])
def test_training_starts_with_the_image_of_open_image_denoise(variant):
    """In the first frame no radiance is accumulated, and the weights of the state are zero."""
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.networks import network

    method = training_task(variant, CPU, seed=0).method
    method.networks.eval()
    clip = procedural(seed=3, size=Size(1, 48, 64), frames=1)
    (result,) = run_clip(replace(method, sampler=None), clip, 2.0)
    intel = Oidn(network(VARIANTS[variant].denoiser))
    expected, _ = intel.denoise(result.frame.gbuffer, result.samples, None)
    # sums in another order, and the exposure is of the same image
    torch.testing.assert_close(result.image, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("variant", "channels"), [("C", 3), ("C+count", 4)])
def test_the_mean_that_enters_the_encoder_is_that_of_the_drawn_samples(variant, channels):
    clip = procedural(seed=3, size=Size(1, 16, 24), frames=1)
    (frame,) = clip
    counts = torch.arange(16 * 24).view(1, 1, 16, 24) % 9
    samples = Samples(frame.pool.read(frame.pool.empty(), counts), counts)
    values = build(variant, CPU, "random").sample_encoding.encode(samples)
    assert values.shape[1] == channels
    for x, y in ((0, 0), (3, 2), (8, 5), (23, 15)):
        n = int(counts[0, 0, y, x])
        radiance = frame.pool.radiance[0, :n, :, y, x]
        mean = torch.log1p(64 * radiance.mean(0)) / math.log(65) if n else torch.full((3,), -1.0)
        torch.testing.assert_close(values[0, :3, y, x], mean)
        assert channels == 3 or values[0, 3, y, x] == n / 8


@pytest.mark.parametrize("variant", ["B1", "B2"])
def test_without_a_state_the_image_depends_on_this_frame_alone(variant):
    method = build(variant, CPU, "random")
    clip = procedural(seed=3, size=Size(1, 32, 32), frames=2)
    first, second = clip
    counts = torch.full((1, 1, 32, 32), 2)
    samples = [Samples(f.pool.read(f.pool.empty(), counts), counts) for f in (first, second)]
    _, state = method.denoise(first.gbuffer, samples[0], method.start(clip.size))
    alone, _ = method.denoise(second.gbuffer, samples[1], method.start(clip.size))
    after, _ = method.denoise(second.gbuffer, samples[1], state)
    assert torch.equal(alone, after)


def test_b1_plans_by_the_last_frames_samples_and_b2_does_not():
    clip = procedural(seed=3, size=Size(1, 32, 32), frames=2)
    first, second = clip
    counts = torch.full((1, 1, 32, 32), 2)
    samples = Samples(first.pool.read(first.pool.empty(), counts), counts)
    for variant, differs in (("B1", True), ("B2", False)):
        method = build(variant, CPU, "random")
        gbuffer = second.gbuffer.select(method.traits.inputs)
        start = method.start(clip.size)
        _, after = method.denoise(first.gbuffer, samples, start)
        plans = [method.plan(gbuffer, samples, state) for state in (after, start)]
        assert (not torch.equal(*plans)) == differs


def draw(frame: Frame, counts: Tensor) -> Samples:
    return Samples(frame.pool.read(frame.pool.empty(), counts), counts)


@pytest.fixture
def after_one():
    """A method, a frame, and the state after it with two samples in each pixel."""
    method = build("", CPU, "random")
    (frame,) = procedural(seed=3, size=Size(1, 32, 32), frames=1)
    samples = draw(frame, torch.full((1, 1, 32, 32), 2))
    _, state = method.denoise(frame.gbuffer, samples, method.start(Size(1, 32, 32)))
    return method, frame, state


def test_a_static_pixel_without_samples_keeps_its_state_and_its_radiance(after_one):
    method, frame, before = after_one
    motion = torch.zeros(1, 2, 32, 32)
    motion[..., 16:] = 0.25  # the right half moves
    counts = torch.full((1, 1, 32, 32), 2)
    counts[..., :16, :] = 0  # the upper half gets nothing
    gbuffer = GBuffer({**frame.gbuffer.buffers, "motion": motion}).select(method.traits.inputs)
    _, after = method.denoise(gbuffer, draw(frame, counts), before)
    held = (after.features == before.features).all(1)
    held &= (after.radiance.accumulated_spp == 2)[:, 0]
    assert held[:, :16, :16].all()
    assert not held[:, 16:].any()
    assert not held[:, :, 16:].any()


def test_a_disoccluded_static_pixel_keeps_nothing(after_one):
    method, frame, before = after_one
    nearer = frame.gbuffer.depth.clone()
    nearer[..., :16] = 1.0  # something hid the left half in the previous frame
    previous = GBuffer({**frame.gbuffer.buffers, "depth": nearer})
    before = replace(before, gbuffer_features=gbuffer_features(previous))
    gbuffer = GBuffer({**frame.gbuffer.buffers, "motion": torch.zeros(1, 2, 32, 32)})
    gbuffer = gbuffer.select(method.traits.inputs)
    _, after = method.denoise(gbuffer, frame.pool.empty(), before)
    held = (after.features == before.features).all(1)
    assert held[..., 16:].all()
    assert not held[..., :16].any()


def test_the_sampler_reads_the_spp_of_the_previous_frame(after_one):
    method, frame, state = after_one
    first, second = method.start(Size(1, 32, 32)).previous_spp, state.previous_spp
    assert (float(first), float(second)) == (1.0, 2.0)
    inputs = method.reproject(replace(frame.gbuffer, static=True), state).sampler_inputs
    assert inputs.shape[1] == method.networks.sampler_channels
    assert torch.allclose(inputs[:, -1], torch.tensor(2.0).log())
    _, unsampled = method.denoise(frame.gbuffer, frame.pool.empty(), state)
    assert method.reproject(frame.gbuffer, unsampled).sampler_inputs.isfinite().all()
    outside = GBuffer({**frame.gbuffer.buffers, "motion": torch.full((1, 2, 32, 32), 100.0)})
    # the first frame of another shot starts from 1 spp, whose logarithm is 0
    assert not method.reproject(outside, state).sampler_inputs[:, -1].any()


def test_the_state_is_reprojected_once_for_planning_and_denoising_a_frame(after_one):
    method, frame, state = after_one
    equal_gbuffer, start = replace(frame.gbuffer), method.start(Size(1, 32, 32))
    with torch.inference_mode():
        history = method.reproject(frame.gbuffer, state)
        assert method.reproject(frame.gbuffer, state) is history
        for other in ((equal_gbuffer, state), (frame.gbuffer, start)):
            assert method.reproject(*other) is not history
        history = method.reproject(frame.gbuffer, state)
    assert method.reproject(frame.gbuffer, state) is not history  # training needs a new graph


def test_the_memo_of_the_reprojection_keeps_no_input_alive(after_one):
    method, frame, state = after_one
    gbuffer = replace(frame.gbuffer)
    with torch.inference_mode():
        _, following = method.denoise(gbuffer, frame.pool.empty(), state)
        method.reproject(gbuffer, following)
    references = [weakref.ref(gbuffer), weakref.ref(following)]
    del gbuffer, following
    assert [reference() for reference in references] == [None, None]


@pytest.mark.parametrize("variant", ["paper", "B1"])
def test_without_accumulated_radiance_sampler_and_encoder_read_the_same(variant):
    method = build(variant, CPU, "random")
    history = method.reproject(GBUFFER, method.start(Size(1, 32, 32)))
    assert torch.equal(history.sampler_inputs, history.inputs)


def test_a_paced_sampler_multiplies_its_action_by_a_power_of_the_budget():
    sampler = Sampler(4, (4, 8, 16), paced=True)
    kaiming_init(sampler, 0)
    sampler.last.weight.data.mul_(0.01)  # where tanh is nearly linear
    inputs = torch.randn(1, 4, 16, 16, generator=torch.Generator().manual_seed(0))
    inputs[:, -1] = math.log(3.0)
    with torch.no_grad():
        plain = sampler(inputs).atanh()
        sampler.pace.copy_(torch.tensor([math.log(0.5), -1.0]))
        torch.testing.assert_close(sampler(inputs).atanh(), plain / 6, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("variant", "low", "high"), [("", math.exp(-1.5), math.exp(1.5)), ("paper", 0, 2)]
)
def test_densities_are_exponential_and_in_the_papers_recipe_linear(variant, low, high):
    method = build(variant, CPU, "random")
    density = method.action_density(torch.tensor([-2.0, -1.0, 0.0, 1.0, 2.0]).view(1, 1, 1, 5))
    torch.testing.assert_close(density.flatten(), torch.tensor([low, low, 1.0, high, high]))


def test_radiance_of_another_surface_has_little_weight(after_one):
    method, frame, state = after_one
    gbuffer = replace(frame.gbuffer, static=True)
    similarity = method.reproject(gbuffer, state).similarity
    assert torch.equal(similarity, torch.ones_like(similarity))
    turned = state.gbuffer_features.clone()
    turned[:, :3] *= -1  # normals
    other = replace(state, gbuffer_features=turned)
    weight = method.reproject(gbuffer, other).radiance.accumulated_spp
    solid = frame.gbuffer.depth.isfinite()
    assert weight[solid].max() < 2 * math.exp(-2 * 2 * 0.99)  # |2n| >= 2 on surfaces
    assert (weight[~solid] == 2).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_more_samples_are_drawn_than_the_encoder_reads(variant):
    assert FAMILY.variants[variant].traits.max_samples == SLOTS


def test_an_untrained_sampler_is_uniform():
    method = training_task("", CPU, seed=0).method
    clip = procedural(seed=1, size=Size(1, 32, 48), frames=1)
    frame = next(iter(clip))
    density = method.plan(frame.gbuffer, frame.pool.empty(), method.start(clip.size))
    assert density.unique().numel() == 1


def contrast(variant: str, steps: int = 6) -> float:
    """Mean absolute action after steps of Adam towards random actions, at the variant's rate."""
    task, generator = training_task(variant, CPU, seed=0), torch.Generator().manual_seed(0)
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
    assert 0 < contrast("sampler-large") <= contrast("")


@pytest.mark.parametrize("variant", ["", "paper", "B1"])
def test_the_last_layer_of_an_untrained_sampler_reads_contrast_in_the_previous_frame(variant):
    """Contrast in its image, its state, or its samples."""
    method = training_task(variant, CPU, seed=0).method
    outputs: list[Tensor] = []
    method.networks.sampler.head.register_forward_hook(lambda layer, x, out: outputs.append(out))
    clip = procedural(seed=1, size=Size(1, 64, 64), frames=1)
    (frame,) = clip
    noise = torch.rand(1, 1, 64, 32, generator=torch.Generator().manual_seed(0)) - 0.5
    state = replace(method.start(clip.size), age=1)
    state.features[:] = 0.1
    state.features[:, :3, :, 32:] += 0.2 * noise
    if method.config.accumulates:
        state.image[:] = 0.5
        state.image[..., 32:] += noise
    with torch.no_grad():
        method.act(replace(frame.gbuffer, static=True), state)
    contrast = outputs[0][0, 0]
    assert contrast[8:-8, 40:-8].mean() > contrast[8:-8, 8:24].mean() + 0.2


def test_every_network_gets_a_gradient_from_one_sequence():
    task = training_task("", CPU, seed=0)
    kaiming_init(task.networks, 0)
    clip = procedural(seed=1, size=Size(2, 32, 32), frames=2)
    for loss in task.losses(clip, 2.0):
        loss.backward()
    without = [k for k, p in task.networks.named_parameters() if p.grad is None or not p.grad.any()]
    # biases of dead units may be untouched, but no whole layer may be
    assert not [name for name in without if name.endswith("weight")]


@pytest.mark.parametrize("bptt", [1, 2])
def test_the_state_carries_a_gradient_over_bptt_frames(bptt):
    method = training_task("", CPU, seed=0).method
    method = assemble(replace(method.config, bptt=bptt), method.traits, method.networks)
    clip = procedural(seed=1, size=Size(1, 32, 32), frames=1)
    frame = next(iter(clip))
    _, state = method.denoise(frame.gbuffer, frame.pool.empty(), method.start(clip.size))
    assert state.features.requires_grad
    state.features.retain_grad()
    image, _ = method.denoise(frame.gbuffer, frame.pool.empty(), state)
    image.sum().backward()
    assert (state.features.grad is None) == (bptt == 1)


@pytest.mark.parametrize(("bptt", "steps"), [(1, 3), (2, 2)])
def test_a_step_is_taken_every_bptt_frames(bptt, steps, monkeypatch):
    monkeypatch.setitem(VARIANTS, "", replace(VARIANTS[""], bptt=bptt))
    task = training_task("", CPU, seed=0)
    clip = procedural(seed=1, size=Size(1, 32, 32), frames=3)
    taken = 0
    for loss in task.losses(clip, 2.0):
        loss.backward()
        taken += 1
    assert taken == steps


def test_the_first_frame_has_no_state():
    state = build("", CPU, "random").start(Size(1, 8, 9))
    assert (state.features == -1).all()
    assert not state.radiance.accumulated_spp.any()


def test_the_former_name_of_reinforce_is_an_alias():
    assert registry.expand(["ours/ppo", "ours/reinforce"]) == ["ours/reinforce"]
    assert "ours/ppo" not in FAMILY.names()
    assert registry.variant("ours/ppo") is FAMILY.variants["reinforce"]
    method = registry.method("ours/ppo", weights="random")
    assert method.config == VARIANTS["reinforce"]


FORMER_FIELDS = {
    "samples": "sample_encoding",
    "remembers": "history_mode",
    "light": "accumulation",
    "kernel": "encoder_kernel",
    "decibels": "log_loss",
    "flat": "ignore_density",
}
FORMER_VALUES = {
    "gathered": "temporal",
    "ppo-pixel": "reinforce",
    "ppo-pixel+surrogate": "reinforce+surrogate",
}


@pytest.mark.parametrize("file", sorted(CARDS.glob("*.safetensors")), ids=lambda file: file.stem)
def test_a_shipped_card_records_the_config_of_its_variant(file):
    """Cards written before hold former names of fields and values."""
    card = read_card(file)
    recorded = {
        FORMER_FIELDS.get(name, name): FORMER_VALUES.get(value, value)
        if isinstance(value, str)
        else value
        for name, value in json.loads(card.config).items()
    }
    config = json.loads(json.dumps(asdict(VARIANTS[card.name.partition("/")[2]].for_training)))
    assert recorded == {name: config[name] for name in recorded}
