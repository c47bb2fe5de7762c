"""One frame of `ours`: history, encoding and the density, variant by variant."""

from __future__ import annotations

import math
import weakref
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from methods.ours.history import RecurrentState, gbuffer_features, radiance_statistics
from methods.ours.method import DENSITIES, Ours, build
from methods.ours.networks import SAMPLE_ENCODINGS
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Size
from rlbench.ops.accumulation import AccumulatedRadiance
from tests.baselines.noise import read_samples

CPU = torch.device("cpu")
SIZE = Size(1, 32, 32)


def test_the_mean_that_enters_the_encoder_is_that_of_the_drawn_samples():
    (frame,) = procedural_clip(seed=3, size=Size(1, 16, 24), frames=1)
    counts = torch.arange(16 * 24).view(1, 1, 16, 24) % 9
    values = SAMPLE_ENCODINGS["mean"].encode(read_samples(frame, counts))
    assert values.shape[1] == 3
    for x, y in ((0, 0), (3, 2), (8, 5), (23, 15)):
        n = int(counts[0, 0, y, x])
        radiance = frame.pool.radiance[0, :n, :, y, x]
        mean = torch.log1p(64 * radiance.mean(0)) / math.log(65) if n else torch.full((3,), -1.0)
        torch.testing.assert_close(values[0, :, y, x], mean)


@pytest.mark.parametrize(
    ("variant", "plans_by_samples"), [("latent-B1", True), ("latent-B2", False)]
)
def test_without_a_state_the_image_depends_on_this_frame_alone(variant, plans_by_samples):
    """B1 plans by the samples of the last frame."""
    method = build(variant, CPU, "random")
    first, second = procedural_clip(seed=3, size=SIZE, frames=2)
    start = method.start(SIZE)
    _, after = method.denoise(first.gbuffer, read_samples(first, 2), start)
    samples = read_samples(second, 2)
    images = [method.denoise(second.gbuffer, samples, state)[0] for state in (after, start)]
    assert torch.equal(*images)
    gbuffer = second.gbuffer.select(method.traits.inputs)
    plans = [method.plan(gbuffer, samples, state) for state in (after, start)]
    assert (not torch.equal(*plans)) == plans_by_samples


def after_frame(variant: str) -> tuple[Ours, Frame, RecurrentState]:
    """A method, a frame, and the state after it with two samples in each pixel."""
    method = build(variant, CPU, "random")
    (frame,) = procedural_clip(seed=3, size=SIZE, frames=1)
    _, state = method.denoise(frame.gbuffer, read_samples(frame, 2), method.start(SIZE))
    return method, frame, state


@pytest.fixture(params=["", "latent"], ids=["ours", "latent"])
def after_one(request):
    """Both methods that accumulate radiance: without a latent, and with one."""
    return after_frame(request.param)


def sample_lower_half(method: Ours, frame: Frame, before: RecurrentState) -> RecurrentState:
    """The state after a second frame; its right half moves, its upper half gets no sample."""
    motion = torch.zeros(1, 2, 32, 32)
    motion[..., 16:] = 0.25
    counts = torch.full((1, 1, 32, 32), 2)
    counts[..., :16, :] = 0
    gbuffer = GBuffer({**frame.gbuffer.buffers, "motion": motion}).select(method.traits.inputs)
    return method.denoise(gbuffer, read_samples(frame, counts), before)[1]


def held_latent(before: RecurrentState, after: RecurrentState) -> Tensor:
    """Where the latent is as before."""
    return (after.features == before.features).all(1)


def test_a_static_pixel_keeps_its_radiance_and_adds_its_samples(after_one):
    after = sample_lower_half(*after_one).radiance.accumulated_spp[0, 0]
    assert (after[:16, :16] == 2).all()
    assert (after[16:, :16] == 4).all()
    assert (after[:16, 16:] < 2).all()
    assert (after[16:, 16:] < 4).all()


def test_a_static_pixel_without_samples_keeps_its_latent():
    before = after_frame("latent")
    held = held_latent(before[2], sample_lower_half(*before))
    assert held[:, :16, :16].all()
    assert not held[:, 16:].any()
    assert not held[:, :, 16:].any()


def disocclude_left_half(method: Ours, frame: Frame, before: RecurrentState) -> RecurrentState:
    """The state after a second frame without motion or samples."""
    nearer = frame.gbuffer.depth.clone()
    nearer[..., :16] = 1.0  # something hid the left half in the previous frame
    previous = GBuffer({**frame.gbuffer.buffers, "depth": nearer})
    before = replace(before, gbuffer_features=gbuffer_features(previous))
    gbuffer = GBuffer({**frame.gbuffer.buffers, "motion": torch.zeros(1, 2, 32, 32)})
    gbuffer = gbuffer.select(method.traits.inputs)
    return method.denoise(gbuffer, frame.pool.empty(), before)[1]


def test_a_disoccluded_static_pixel_keeps_hardly_any_radiance(after_one):
    after = disocclude_left_half(*after_one).radiance.accumulated_spp
    assert (after[..., 16:] == 2).all()
    assert (after[..., :16] < 0.1).all()


def test_a_disoccluded_static_pixel_keeps_no_latent():
    before = after_frame("latent")
    held = held_latent(before[2], disocclude_left_half(*before))
    assert held[..., 16:].all()
    assert not held[..., :16].any()


def test_the_sampler_reads_the_spp_of_the_previous_frame(after_one):
    method, frame, state = after_one
    first, second = method.start(SIZE).previous_spp, state.previous_spp
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
    equal_gbuffer, start = replace(frame.gbuffer), method.start(SIZE)
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


@pytest.mark.parametrize("variant", ["paper", "latent-B1"])
def test_without_accumulated_radiance_sampler_and_encoder_read_the_same(variant):
    method, frame, _ = after_frame(variant)
    history = method.reproject(frame.gbuffer, method.start(SIZE))
    assert torch.equal(history.sampler_inputs, history.inputs)


@pytest.mark.parametrize(
    ("name", "low", "high"), [("exponential", math.exp(-1.5), math.exp(1.5)), ("linear", 0, 2)]
)
def test_actions_beyond_the_range_have_the_density_of_its_ends(name, low, high):
    density = DENSITIES[name](torch.tensor([-2.0, -1.0, 0.0, 1.0, 2.0]).view(1, 1, 1, 5))
    torch.testing.assert_close(density.flatten(), torch.tensor([low, low, 1.0, high, high]))


def with_turned_normals(state: RecurrentState, first_column: int) -> RecurrentState:
    turned = state.gbuffer_features.clone()
    turned[:, :3, :, first_column:] *= -1
    return replace(state, gbuffer_features=turned)


def test_radiance_of_another_surface_has_less_weight(after_one):
    method, frame, state = after_one
    gbuffer = replace(frame.gbuffer, static=True)
    similarity = method.reproject(gbuffer, state).similarity
    assert torch.equal(similarity, torch.ones_like(similarity))
    other = with_turned_normals(state, 24)  # a quarter of the image: all of it would be a cut
    weight = method.reproject(gbuffer, other).radiance.accumulated_spp
    solid = frame.gbuffer.depth.isfinite()
    solid[..., :24] = False
    assert weight[solid].max() < 2 * math.exp(-2 * 0.99 / 4)  # |2n| >= 2 on surfaces
    assert (weight[~solid] == 2).all()


def test_after_a_cut_without_motion_that_says_so_there_is_no_history(after_one):
    method, frame, state = after_one
    other = with_turned_normals(state, 8)
    history = method.reproject(replace(frame.gbuffer, static=True), other)
    assert not history.radiance.accumulated_spp.any()
    assert (history.previous_spp == 1).all()


def test_a_weight_that_underflow_would_decide_is_zero(after_one):
    """exp(-500) is 0 in float32 and positive in float64; either must mean: no sample."""
    method, frame, state = after_one
    far, solid = state.gbuffer_features.clone(), frame.gbuffer.depth.isfinite()
    far[:, 6:] = solid * 1.0  # as if the camera had touched the surfaces
    other = replace(state, gbuffer_features=far)
    history = method.reproject(replace(frame.gbuffer, static=True), other)
    weight, similarity = history.radiance.accumulated_spp, history.similarity
    assert ((similarity[solid] > 0) & (similarity[solid] < 1e-4)).any()
    assert ((weight == 0) | (weight > 1e-3)).all()


def test_a_static_pixel_trusts_all_its_samples(after_one):
    """Whatever encoder or rule says: only then does the error of a still camera fall for good."""
    method, frame, before = after_one
    gbuffer = replace(frame.gbuffer, static=True)
    keep = replace(method, accumulator=replace(method.accumulator, antilag=False))
    gbuffer = gbuffer.select(method.traits.inputs)
    _, after = keep.denoise(gbuffer, read_samples(frame, 3), before)
    assert (after.radiance.accumulated_spp == 5).all()


@pytest.mark.parametrize(("variant", "channels"), [("", 0), ("latent", 32)])
def test_the_first_frame_has_no_state(variant, channels):
    state = build(variant, CPU, "random").start(Size(1, 8, 9))
    assert torch.equal(state.features, torch.full((1, channels, 8, 9), -1.0))
    assert not state.radiance.accumulated_spp.any()


def test_history_that_is_half_rejected_has_half_the_weight_and_half_the_similarity(after_one):
    method, frame, state = after_one
    history = method.reproject(frame.gbuffer, state)
    half = history.with_confidence(torch.full_like(history.similarity, 0.5))
    assert torch.equal(half.similarity, history.similarity / 2)
    assert torch.equal(half.radiance.accumulated_spp, history.radiance.accumulated_spp / 2)
    assert torch.equal(half.radiance.mean, history.radiance.mean)


def test_networks_read_16_samples_as_a_half_and_a_deviation_of_the_mean_as_a_half():
    mean, square = torch.full((1, 3, 2, 2), 2.0), torch.full((1, 1, 2, 2), 8.0)
    radiance = AccumulatedRadiance(mean, square, torch.full((1, 1, 2, 2), 16.0))
    relative, weight = radiance_statistics(radiance).unbind(1)
    torch.testing.assert_close(weight, torch.full((1, 2, 2), 0.5))
    torch.testing.assert_close(relative, torch.full((1, 2, 2), 0.5), atol=2e-4, rtol=0)
