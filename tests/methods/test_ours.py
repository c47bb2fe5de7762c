"""The proposed method: its sizes, its variants, its gradients, and the policy that trains it."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import pytest
import torch
from torch import Tensor, nn

from baselines.oidn.method import Oidn
from methods.ours import FAMILY
from methods.ours.method import build
from methods.ours.networks import Encoder, Networks, Sampler
from methods.ours.state import gbuffer_features
from methods.ours.train import trainer
from methods.ours.variants import BASE, SLOTS, VARIANTS
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Frame, GBuffer, Samples, Size
from rlbench.ops.init import kaiming_init
from rlbench.ops.losses import l1_ms_ssim_loss
from rlbench.ops.transfer import log_forward
from rlbench.run import run_clip, unroll

CPU = torch.device("cpu")


VIEW = next(iter(procedural(seed=3, size=Size(1, 32, 32), frames=1))).gbuffer


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


def test_a_step_is_as_long_where_the_loss_is_large_as_where_it_is_small():
    """The gradient is that of the loss over the loss: equal decibels count equally."""
    made, clip = trainer("A2", CPU, seed=0), procedural(seed=3, size=Size(1, 32, 32), frames=1)
    ((loss,), (shown,)) = made.losses(clip, 1.0), unroll(made.method, clip, 1.0)
    plain = l1_ms_ssim_loss(log_forward(shown.image), log_forward(shown.frame.reference.mean))
    weights = list(made.networks.parameters())
    found = torch.autograd.grad(loss, weights, allow_unused=True)
    wanted = torch.autograd.grad(plain, weights, allow_unused=True)
    factor = 0.02 / plain.item()
    for mine, theirs in zip(found, wanted, strict=True):
        assert (mine is None) == (theirs is None)
        if mine is not None:
            torch.testing.assert_close(mine, theirs * factor, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize(
    ("variant", "fields"),
    [
        ("", set()),
        ("paper", {"light", "density", "decibels", "learner"}),
        ("A1", {"learner"}),
        ("A2", {"sampler"}),
        ("B1", {"encoder", "remembers", "light"}),
        ("B2", {"encoder", "remembers", "light"}),
        ("C", {"samples"}),
        ("ppo", {"learner"}),
        ("C+count", {"samples"}),
        ("small", {"sampler", "kernel", "denoiser"}),
        ("flat", {"flat"}),
        ("lag", {"antilag"}),
        ("sampler-small", {"sampler"}),
        ("sampler-large", {"sampler"}),
        ("encoder-small", {"kernel"}),
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
    """In the first frame nothing is gathered yet, and the state says nothing yet."""
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.networks import network

    method = trainer(variant, CPU, seed=0).method
    method.networks.eval()
    clip = procedural(seed=3, size=Size(1, 48, 64), frames=1)
    (shown,) = run_clip(replace(method, config=replace(method.config, flat=True)), clip, 2.0)
    intels = Oidn(network(VARIANTS[variant].denoiser))
    theirs, _ = intels.denoise(shown.frame.gbuffer, shown.samples, None)
    # sums in another order, and the exposure is of the same image
    torch.testing.assert_close(shown.image, theirs, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("variant", "channels"), [("C", 3), ("C+count", 4)])
def test_a_mean_that_enters_the_encoder_is_of_the_samples_that_were_bought(variant, channels):
    clip = procedural(seed=3, size=Size(1, 16, 24), frames=1)
    (frame,) = clip
    counts = torch.arange(16 * 24).view(1, 1, 16, 24) % 9
    samples = Samples(frame.pool.read(frame.pool.empty(), counts), counts)
    values = build(variant, CPU, "random")._values(samples)
    assert values.shape[1] == channels
    for x, y in ((0, 0), (3, 2), (8, 5), (23, 15)):
        n = int(counts[0, 0, y, x])
        taken = frame.pool.radiance[0, :n, :, y, x]
        mean = torch.log1p(64 * taken.mean(0)) / math.log(65) if n else torch.full((3,), -1.0)
        torch.testing.assert_close(values[0, :3, y, x], mean)
        assert channels == 3 or values[0, 3, y, x] == n / 8


@pytest.mark.parametrize("variant", ["B1", "B2"])
def test_without_a_state_the_image_is_of_this_frame_alone(variant):
    method = build(variant, CPU, "random")
    clip = procedural(seed=3, size=Size(1, 32, 32), frames=2)
    first, second = clip
    counts = torch.full((1, 1, 32, 32), 2)
    samples = [Samples(f.pool.read(f.pool.empty(), counts), counts) for f in (first, second)]
    _, left = method.denoise(first.gbuffer, samples[0], method.start(clip.size))
    alone, _ = method.denoise(second.gbuffer, samples[1], method.start(clip.size))
    after, _ = method.denoise(second.gbuffer, samples[1], left)
    assert torch.equal(alone, after)


def test_b1_plans_by_the_last_frames_samples_and_b2_does_not():
    clip = procedural(seed=3, size=Size(1, 32, 32), frames=2)
    first, second = clip
    counts = torch.full((1, 1, 32, 32), 2)
    samples = Samples(first.pool.read(first.pool.empty(), counts), counts)
    for variant, moves in (("B1", True), ("B2", False)):
        method = build(variant, CPU, "random")
        gbuffer = second.gbuffer.select(method.traits.inputs)
        _, left = method.denoise(first.gbuffer, samples, method.start(clip.size))
        plans = [method.plan(gbuffer, samples, state) for state in (left, method.start(clip.size))]
        assert (not torch.equal(*plans)) == moves


def bought(frame: Frame, counts: Tensor) -> Samples:
    return Samples(frame.pool.read(frame.pool.empty(), counts), counts)


@pytest.fixture
def after_one():
    """A method, a frame, and what it left when each pixel had two samples."""
    method = build("", CPU, "random")
    (frame,) = procedural(seed=3, size=Size(1, 32, 32), frames=1)
    samples = bought(frame, torch.full((1, 1, 32, 32), 2))
    _, left = method.denoise(frame.gbuffer, samples, method.start(Size(1, 32, 32)))
    return method, frame, left


def test_a_still_pixel_without_samples_keeps_its_state_and_its_light(after_one):
    method, frame, before = after_one
    motion = torch.zeros(1, 2, 32, 32)
    motion[..., 16:] = 0.25  # the right half moves
    counts = torch.full((1, 1, 32, 32), 2)
    counts[..., :16, :] = 0  # the upper half gets nothing
    gbuffer = GBuffer({**frame.gbuffer.buffers, "motion": motion}).select(method.traits.needs)
    _, after = method.denoise(gbuffer, bought(frame, counts), before)
    kept = (after.state == before.state).all(1) & (after.past.light.weight == 2)[:, 0]
    assert kept[:, :16, :16].all()
    assert not kept[:, 16:].any()
    assert not kept[:, :, 16:].any()


def test_what_is_uncovered_in_a_still_picture_keeps_nothing(after_one):
    method, frame, before = after_one
    nearer = frame.gbuffer.depth.clone()
    nearer[..., :16] = 1.0  # what hid the left half in the last frame
    hid = {**frame.gbuffer.buffers, "depth": nearer}
    before = before._replace(past=before.past._replace(seen=gbuffer_features(GBuffer(hid))))
    gbuffer = GBuffer({**frame.gbuffer.buffers, "motion": torch.zeros(1, 2, 32, 32)})
    gbuffer = gbuffer.select(method.traits.needs)
    _, after = method.denoise(gbuffer, frame.pool.empty(), before)
    kept = (after.state == before.state).all(1)
    assert kept[..., 16:].all()
    assert not kept[..., :16].any()


def test_the_sampler_is_told_how_many_samples_the_last_frame_got(after_one):
    method, frame, left = after_one
    (first,), told = method.start(Size(1, 32, 32)).past.spent, left.past.spent
    assert (float(first), float(told)) == (1.0, 2.0)
    seen = method.known(replace(frame.gbuffer, static=True), left).foreseen
    assert seen.shape[1] == method.networks.foreseen
    assert torch.allclose(seen[:, -1], torch.tensor(2.0).log())
    _, none = method.denoise(frame.gbuffer, frame.pool.empty(), left)
    assert method.known(frame.gbuffer, none).foreseen.isfinite().all()  # none were bought
    outside = GBuffer({**frame.gbuffer.buffers, "motion": torch.full((1, 2, 32, 32), 100.0)})
    assert not method.known(outside, left).foreseen[:, -1].any()  # another shot: as before any


def test_memory_is_moved_once_for_planning_and_denoising_a_frame(after_one):
    method, frame, left = after_one
    again, none = replace(frame.gbuffer), method.start(Size(1, 32, 32))
    with torch.inference_mode():
        known = method.known(frame.gbuffer, left)
        assert method.known(frame.gbuffer, left) is known
        for gbuffer, memory in ((again, left), (frame.gbuffer, none)):
            assert method.known(gbuffer, memory) is not known
        known = method.known(frame.gbuffer, left)
    assert method.known(frame.gbuffer, left) is not known  # whoever trains needs its graph


@pytest.mark.parametrize("variant", ["paper", "B1"])
def test_where_no_light_is_gathered_the_sampler_sees_what_the_encoder_sees(variant):
    method = build(variant, CPU, "random")
    known = method.known(VIEW, method.start(Size(1, 32, 32)))
    assert known.sampler_input is known.seen


def test_a_paced_sampler_multiplies_its_action_by_a_power_of_the_budget():
    sampler = Sampler(4, (4, 8, 16), paced=True)
    kaiming_init(sampler, 0)
    sampler.last.weight.data.mul_(0.01)  # far from where tanh is flat
    known = torch.randn(1, 4, 16, 16, generator=torch.Generator().manual_seed(0))
    known[:, -1] = math.log(3.0)
    with torch.no_grad():
        plain = sampler(known).atanh()
        sampler.pace.copy_(torch.tensor([math.log(0.5), -1.0]))
        torch.testing.assert_close(sampler(known).atanh(), plain / 6, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("variant", "low", "high"), [("", math.exp(-1.5), math.exp(1.5)), ("paper", 0, 2)]
)
def test_densities_grow_by_factors_and_in_the_papers_recipe_by_steps(variant, low, high):
    method = build(variant, CPU, "random")
    found = method.density(torch.tensor([-2.0, -1.0, 0.0, 1.0, 2.0]))
    torch.testing.assert_close(found, torch.tensor([low, low, 1.0, high, high]))


def test_light_of_another_surface_is_worth_little(after_one):
    method, frame, left = after_one
    gbuffer = replace(frame.gbuffer, static=True)
    moved = method.known(gbuffer, left).moved
    assert torch.equal(moved.same, torch.ones_like(moved.same))
    turned = left.past.seen.clone()
    turned[:, :3] *= -1  # normals
    other = left._replace(past=left.past._replace(seen=turned))
    weight = method.known(gbuffer, other).moved.light.weight
    solid = frame.gbuffer.depth.isfinite()
    assert weight[solid].max() < 2 * math.exp(-2 * 2 * 0.99)  # |2n| >= 2 on surfaces
    assert (weight[~solid] == 2).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_more_samples_are_bought_than_the_encoder_sees(variant):
    assert FAMILY.variants[variant].traits.max_samples == SLOTS


def test_an_untrained_sampler_is_uniform():
    method = trainer("", CPU, seed=0).method
    clip = procedural(seed=1, size=Size(1, 32, 48), frames=1)
    frame = next(iter(clip))
    wish = method.plan(frame.gbuffer, frame.pool.empty(), method.start(clip.size))
    assert wish.unique().numel() == 1


def contrast(variant: str, steps: int = 6) -> float:
    """Mean absolute action after steps of Adam towards random actions, at the variant's rate."""
    made, generator = trainer(variant, CPU, seed=0), torch.Generator().manual_seed(0)
    sampler = made.networks.sampler
    adam = torch.optim.Adam(sampler.parameters(), made.max_lr * made.lr_multipliers["sampler"])
    seen = torch.rand(1, made.networks.foreseen, 16, 16, generator=generator)
    wanted = torch.rand(1, 1, 16, 16, generator=generator) * 2 - 1
    for _ in range(steps):
        adam.zero_grad()
        (-sampler(seen) * wanted).mean().backward()
        adam.step()
    return float(sampler(seen).detach().abs().mean())


def test_steps_move_the_map_of_a_wider_sampler_no_further():
    """At the full rate six steps end at 0.91, with nearly all of the map at its bounds."""
    assert 0 < contrast("sampler-large") <= contrast("")


@pytest.mark.parametrize("variant", ["", "paper", "B1"])
def test_the_samplers_last_layer_is_shown_where_the_last_frame_was_rough(variant):
    """What it is shown of the last frame: its image, its state, or its samples."""
    method = trainer(variant, CPU, seed=0).method
    shown: list[Tensor] = []
    method.networks.sampler.head.register_forward_hook(lambda layer, x, out: shown.append(out))
    clip = procedural(seed=1, size=Size(1, 64, 64), frames=1)
    (frame,) = clip
    noise = torch.rand(1, 1, 64, 32, generator=torch.Generator().manual_seed(0)) - 0.5
    state = method.start(clip.size)._replace(age=1)
    state.state[:] = 0.1
    state.state[:, :3, :, 32:] += 0.2 * noise
    if state.past is not None:
        state.past.image[:] = 0.5
        state.past.image[..., 32:] += noise
    with torch.no_grad():
        method.act(replace(frame.gbuffer, static=True), state)
    contrast = shown[0][0, 0]
    assert contrast[8:-8, 40:-8].mean() > contrast[8:-8, 8:24].mean() + 0.2


def test_every_network_gets_a_gradient_from_one_sequence():
    made = trainer("", CPU, seed=0)
    kaiming_init(made.networks, 0)
    clip = procedural(seed=1, size=Size(2, 32, 32), frames=2)
    for loss in made.losses(clip, 2.0):
        loss.backward()
    without = [k for k, p in made.networks.named_parameters() if p.grad is None or not p.grad.any()]
    # biases of dead units may be untouched, but no whole layer may be
    assert not [name for name in without if name.endswith("weight")]


@pytest.mark.parametrize("bptt", [1, 2])
def test_the_state_carries_a_gradient_over_as_many_frames_as_asked_for(bptt):
    method = trainer("", CPU, seed=0).method
    method = replace(method, config=replace(method.config, bptt=bptt))
    clip = procedural(seed=1, size=Size(1, 32, 32), frames=1)
    frame = next(iter(clip))
    _, memory = method.denoise(frame.gbuffer, frame.pool.empty(), method.start(clip.size))
    assert memory.state.requires_grad
    memory.state.retain_grad()
    image, _ = method.denoise(frame.gbuffer, frame.pool.empty(), memory)
    image.sum().backward()
    assert (memory.state.grad is None) == (bptt == 1)


@pytest.mark.parametrize(("bptt", "steps"), [(1, 3), (2, 2)])
def test_a_step_is_taken_for_as_many_frames_as_gradients_flow_through(bptt, steps, monkeypatch):
    monkeypatch.setitem(VARIANTS, "", replace(VARIANTS[""], bptt=bptt))
    made = trainer("", CPU, seed=0)
    clip = procedural(seed=1, size=Size(1, 32, 32), frames=3)
    found = 0
    for loss in made.losses(clip, 2.0):
        loss.backward()
        found += 1
    assert found == steps


def test_the_first_frame_has_no_state():
    memory = build("", CPU, "random").start(Size(1, 8, 9))
    assert (memory.state == -1).all()
    assert not memory.past.light.accumulated_spp.any()
