"""Weighted history of ntas, imcd and nppd: no weight for other surfaces and other light."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from baselines.accumulate.memory import (
    LightHistory,
    Memory,
    empty_memory,
    reproject_image,
    reproject_memory,
    surface_weight,
    weigh_history,
)
from rlbench import registry
from rlbench.checks.frame_edits import edit_radiance, start_new_shot, to_clip, with_buffers
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Size, StoredPool
from rlbench.ops.nested_tensors import has_graph
from rlbench.ops.reprojection import reproject, reproject_bicubic
from rlbench.run import run_clip
from tests.baselines.noise import random_tensor, read_samples

SIZE = Size(1, 64, 64)
RIVALS = ["ntas", "imcd", "nppd"]
HISTORY = [f"{name}/history" for name in RIVALS]
GAIN = 8.0  # of a light that is switched on
REACH = 28  # pixels, half of antilag's widest window, and a cell for interpolation
FILTER = 12  # pixels across which filters mix both halves
LAMBDA = 51  # channel of the finest head of nppd


def still_frames(count: int) -> list[Frame]:
    """A still image, of which every sample is the reference."""
    frames = []
    for frame in procedural_clip(3, SIZE, count, static=True):
        samples = frame.reference.mean[:, None].expand_as(frame.pool.radiance).clone()
        frames.append(replace(frame, pool=StoredPool(samples, frame.pool.rounding_seeds)))
    return frames


def switch_light(frame: Frame) -> Frame:
    """The frame with the left half brighter."""
    gain = torch.ones(SIZE.w)
    gain[: SIZE.w // 2] = GAIN
    return edit_radiance(frame, lambda part: part * gain)


def weigh_frame(frame: Frame, memory: Memory | None = None) -> tuple[Tensor, Memory]:
    """The weight of the history, and the memory after the frame, whose image is the truth."""
    memory = memory or empty_memory(SIZE, torch.device("cpu"))
    history = reproject_memory(frame.gbuffer, memory)
    weight, memory = weigh_history(frame.gbuffer, read_samples(frame, 2), memory, history)
    return weight, replace(memory, image=frame.reference.mean)


def weigh(frames: Sequence[Frame]) -> list[Tensor]:
    """The weight of history in each frame."""
    memory, weights = None, []
    for frame in frames:
        weight, memory = weigh_frame(frame, memory)
        weights.append(weight)
    return weights


def test_the_first_frame_has_no_history() -> None:
    assert not weigh(still_frames(1))[0].any()


def test_equal_frames_keep_the_history_in_full() -> None:
    for weight in weigh(still_frames(4))[1:]:
        # rounding of the accumulated mean counts for a change of its size
        torch.testing.assert_close(weight, torch.ones_like(weight), rtol=0, atol=1e-4)


def test_a_switched_light_takes_its_weight_from_the_history() -> None:
    *before, last = still_frames(4)
    weight = weigh([*before, switch_light(last)])[-1]
    middle = SIZE.w // 2
    assert not weight[..., :middle].any()  # brighter by more than a third
    assert (weight[..., middle + REACH :] > 0.999).all()
    again = weigh([*before, *[switch_light(frame) for frame in (last, last)]])[-1]
    assert (again > 0.999).all()  # the new light is accumulated


def test_other_surfaces_weigh_as_much_as_they_are_similar() -> None:
    first, second = still_frames(2)
    normal = second.gbuffer.normal.clone()
    normal[..., :20] = -normal[..., :20]
    albedo = (second.gbuffer.albedo + 0.05).clamp_max(1.0)
    weight = weigh([first, with_buffers(second, normal=normal, albedo=albedo)])[-1]
    difference = (normal - first.gbuffer.normal).abs() + (albedo - first.gbuffer.albedo).abs()
    expected = torch.exp(-difference.sum(1, keepdim=True) / 4)
    torch.testing.assert_close(weight, expected, rtol=1e-3, atol=1e-4)
    assert weight.min() < 0.6
    assert weight.max() > 0.95


def test_history_from_outside_the_image_has_no_weight() -> None:
    first, second = procedural_clip(3, SIZE, 2)
    assert not weigh([first, start_new_shot(second)])[-1].any()


def test_the_weight_before_sampling_is_the_similarity_alone() -> None:
    first, second = procedural_clip(3, SIZE, 2)
    nothing = reproject_memory(first.gbuffer, empty_memory(SIZE, torch.device("cpu")))
    assert not surface_weight(nothing).any()
    _, memory = weigh_frame(first)
    history = reproject_memory(second.gbuffer, memory)
    before = surface_weight(history)
    after, _ = weigh_frame(switch_light(second), memory)
    assert (before == history.similarity.where(history.similarity > 1e-3, 0)).all()
    assert (after <= before).all()
    assert after.sum() < 0.8 * before.sum()


def test_weighted_light_moves_linearly_and_the_image_in_log_transfer() -> None:
    """Where nothing contradicts the history; features move by bilinear taps."""
    first, second = still_frames(2)
    flat = {name: torch.full_like(first.gbuffer.extra(name), 0.5) for name in ("albedo", "normal")}
    depth = torch.ones_like(first.gbuffer.depth)
    first, second = (with_buffers(f, **flat, depth=depth) for f in (first, second))
    motion = torch.full((1, 2, SIZE.h, SIZE.w), 0.25)
    noisy, denoised, features = (
        random_tensor(1, c, SIZE.h, SIZE.w, seed=seed) for seed, c in enumerate((3, 3, 5))
    )
    gbuffer = GBuffer({**second.gbuffer.buffers, "motion": motion})
    _, memory = weigh_frame(first)
    state = LightHistory(noisy, denoised, features, 1, memory)
    moved, weight = state.reproject(gbuffer, read_samples(second, 2))
    known = weight > 0
    assert known.float().mean() > 0.5
    light, _ = reproject_bicubic(noisy, motion)
    image, _ = reproject_image(denoised, motion)
    expected = (light, image, reproject(features, motion)[0])
    for part, values in zip(moved[:3], expected, strict=True):
        torch.testing.assert_close(part, values.where(known, 0.0))


def test_a_lamp_does_not_dominate_the_pixel_beside_it() -> None:
    """Half of a lamp of 1000 and half of a wall of 1 is about their geometric mean, not 500."""
    image = torch.ones(1, 3, SIZE.h, SIZE.w)
    image[..., 32:] = 1000.0
    motion = torch.zeros(1, 2, SIZE.h, SIZE.w)
    motion[:, 0] = 0.5
    moved, valid = reproject_image(image, motion)
    assert moved[..., 10, 31].mean() == pytest.approx(1000**0.5, rel=0.05)
    assert valid[..., :-1].all()
    assert not valid[..., -1].any()


def images(name: str, *frames: Frame) -> list[Tensor]:
    """The images of a method with random weights."""
    method = registry.load_method(name, weights="random")
    return [result.image for result in run_clip(method, to_clip(frames), 2.0)]


@pytest.mark.parametrize("name", RIVALS)
def test_without_motion_noise_and_change_the_variant_is_the_method(name: str) -> None:
    """All history has the weight 1; reprojection has nothing to do."""
    pairs = zip(*(images(row, *still_frames(4)) for row in (name, f"{name}/history")), strict=True)
    for expected, image in pairs:
        # log transfer and back, in each frame; weights of 0.9999
        torch.testing.assert_close(image, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", HISTORY)
def test_a_frame_of_other_surfaces_is_a_first_frame(name: str) -> None:
    """Similarity 0 is no history, although motion is valid and the light is the same."""
    first, second = procedural_clip(3, SIZE, 2, static=True)
    depth = torch.ones_like(first.gbuffer.depth)
    first, turned = with_buffers(first, depth=depth), with_buffers(second, depth=1000 * depth)
    assert not weigh([first, turned])[-1].any()
    after = images(name, first, turned)[-1]
    assert torch.equal(after, images(name, turned)[0])
    assert not torch.equal(after, images(name.removesuffix("/history"), first, turned)[-1])


@pytest.mark.parametrize("name", HISTORY)
def test_a_switched_light_is_followed_at_once(name: str) -> None:
    """By the variant; the method itself, with the same weights, keeps old light."""
    *before, last = still_frames(4)
    switched, errors = switch_light(last), []
    for row in (name.removesuffix("/history"), name):
        difference = images(row, *before, switched)[-1] - images(row, switched)[0]
        errors.append(float(difference[..., : SIZE.w // 2 - FILTER].abs().mean()))
    assert errors[1] < 0.01 * errors[0]


@pytest.mark.parametrize("name", HISTORY)
def test_training_reaches_every_parameter_and_leaves_the_memory_without_a_graph(name: str) -> None:
    train = importlib.import_module(f"baselines.{name.partition('/')[0]}.train")
    task = train.training_task("history", torch.device("cpu"), 0)
    clip = procedural_clip(5, Size(2, 64, 64), 2)
    for loss in task.losses(clip, 2.0):
        loss.backward()
    without = [n for n, p in task.networks.named_parameters() if p.grad is None or not p.grad.any()]
    assert without == []
    state = task.method.start(Size(2, 64, 64))
    for frame in clip:
        image, state = task.method.denoise(frame.gbuffer, read_samples(frame, 2), state)
        assert image.requires_grad
        assert not has_graph(state.memory)


@pytest.mark.parametrize("name", ["imcd/history", "nppd/history"])
def test_light_is_kept_by_its_weight_where_lambda_is_one(name: str) -> None:
    first, second = still_frames(2)
    changed = with_buffers(second, normal=second.gbuffer.normal * 0.8)
    changed = edit_radiance(changed, lambda part: part * 1.1)
    method = registry.load_method(name, weights="random")
    _, before = method.denoise(first.gbuffer, read_samples(first, 2), method.start(SIZE))
    weight, _ = weigh_frame(changed, before.memory)
    assert 0.2 < weight.mean() < 0.9

    unet = method.networks.unet
    bias = unet.last.bias if name.startswith("imcd") else unet.heads[0].bias
    bias.data[-1 if name.startswith("imcd") else LAMBDA] = 80.0
    _, after = method.denoise(changed.gbuffer, read_samples(changed, 2), before)
    expected = torch.lerp(1.1 * before.irradiance, before.irradiance, weight)
    torch.testing.assert_close(after.irradiance, expected, rtol=1e-5, atol=1e-6)
