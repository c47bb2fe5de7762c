"""BMFR: the fit of all blocks is that of NumPy block by block; a frame is that of plain loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.bmfr.method import MIN_NORMAL_COSINE, antialias, build
from baselines.bmfr.regression import (
    FEATURES,
    OFFSETS,
    RIDGE,
    feature_noise,
    fit_blocks,
    lay_blocks,
    solve_least_squares,
    stack_features,
)
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.color import REC709_LUMINANCE
from rlbench.ops.demodulation import reflectance, surface_mask
from rlbench.ops.surface_taps import find_surface_taps
from tests.baselines import regression_twins as twins
from tests.baselines.moving import FRAMES, Moving, frame
from tests.baselines.noise import array, one_sample, random_tensor

CPU = torch.device("cpu")
FLAT = torch.ones(1, 1, 5, 7), torch.ones(1, 3, 5, 7) / 3**0.5  # depth and normal


def surface_of(gbuffer: GBuffer) -> tuple[Tensor, Tensor, Tensor]:
    """Where a surface is, its depth and its normal."""
    surface = surface_mask(gbuffer.albedo, gbuffer.depth)
    return surface, gbuffer.depth.where(surface, 0.0), gbuffer.normal.where(surface, 0.0)


def run(frames: list[Moving], variant: str = "", **changed: float) -> list[Tensor]:
    method = build(variant, CPU, None)
    method = replace(method, config=replace(method.config, **changed))
    state, images = method.start(Size(*frames[0].radiance.shape[::2], 32)), []
    for each in frames:
        image, state = method.denoise(each.gbuffer, one_sample(each.radiance), state)
        images.append(image)
    return images


def test_least_squares_are_those_of_numpy():
    features, values = random_tensor(5, FEATURES, 200), random_tensor(5, 3, 200, seed=1)
    found = solve_least_squares(features, values, ridge=0.5)
    regular = 0.5 * np.eye(FEATURES)
    for block in range(5):
        matrix = np.concatenate((features[block].T.double(), regular))
        target = np.concatenate((values[block].T.double(), np.zeros((FEATURES, 3))))
        expected = np.linalg.lstsq(matrix, target, rcond=None)[0]
        np.testing.assert_allclose(found[block], expected, rtol=1e-3, atol=1e-4)  # float32


@pytest.mark.parametrize("index", [0, 4, 9])
@pytest.mark.parametrize("size", [(45, 61), (9, 13)], ids=str)
def test_the_fit_of_all_blocks_is_that_of_numpy_block_by_block(index, size):
    h, w = size
    light, surface = random_tensor(1, 3, h, w), random_tensor(1, 1, h, w, seed=1) > 0.2
    surface[..., : h // 3, :] = False  # so that some blocks have no surface at all
    normal = torch.nn.functional.normalize(random_tensor(1, 3, h, w, seed=2) - 0.5, dim=1)
    depth = 2 + 4 * random_tensor(1, 1, h, w, seed=3)
    features = stack_features(normal, depth)
    number = torch.tensor([index])
    fitted = fit_blocks(light, features, surface, number, noise=0.01)
    noise = feature_noise(number, 0.01)[0, :, 0].double().numpy()
    assert (noise[0] == 0).all()
    assert -0.01 <= noise.min() < -0.009 < 0.009 < noise.max() <= 0.01
    expected = twins.fit_by_blocks(
        array(light), array(features), array(surface)[..., 0] > 0, OFFSETS[index], noise, RIDGE
    )
    found = np.where(array(surface) > 0, array(fitted), 0)
    np.testing.assert_allclose(found, expected, rtol=1e-2, atol=1e-3)  # float32, 10 columns


@pytest.mark.parametrize("index", range(len(OFFSETS)))
def test_blocks_at_every_offset_hold_every_pixel(index):
    image = torch.arange(45 * 61.0).view(1, 1, 45, 61)
    blocks = lay_blocks(torch.tensor([index]), 45, 61)
    assert torch.equal(blocks.scatter(blocks.gather(image), 45, 61), image)


def test_every_frame_equals_plain_loops():
    """Moving surfaces, disocclusions, background, an emitter, fireflies."""
    frames = [frame(index) for index in range(FRAMES)]
    images = run(frames)
    state = None
    for index, (moving, image) in enumerate(zip(frames, images, strict=True)):
        expected, state = denoise_in_loops(moving, state, index)
        # the fit solves systems of 10 columns in float32
        np.testing.assert_allclose(array(image), expected, rtol=2e-2, atol=2e-3)


def denoise_in_loops(moving: Moving, state, index: int):
    surface, depth, normal = surface_of(moving.gbuffer)
    mask, albedo = array(surface) > 0, array(reflectance(moving.gbuffer.albedo))
    mask = mask & ~outshines(np.where(mask, moving.noisy / albedo, 0) @ REC709_LUMINANCE, mask)
    now = np.where(mask, array(depth), 0)[..., 0], np.where(mask, array(normal), 0)
    light = np.where(mask, moving.noisy / albedo, 0)
    length = mask[..., 0].astype(float)
    motion = moving.arrays[3]
    old_filtered = np.zeros_like(light)
    if state is not None:
        taps = twins.surface_taps(motion, now, state["surface"], MIN_NORMAL_COSINE)
        old = twins.gather(np.dstack((state["light"], state["filtered"], state["length"])), taps)
        length = length + old[..., 6]
        alpha = np.where(mask, np.maximum(1 / np.maximum(length, 1)[..., None], 0.2), 0)
        light = alpha * light + (1 - alpha) * old[..., :3]
        old_filtered = old[..., 3:6]
    features = array(stack_features(normal, depth)) * mask
    noise = feature_noise(torch.tensor([index]), 0.01)[0, :, 0].double().numpy()
    fitted = twins.fit_by_blocks(light, features, mask[..., 0], OFFSETS[index], noise, RIDGE)
    alpha = np.where(mask, np.maximum(1 / np.maximum(length, 1)[..., None], 0.1), 0)
    filtered = alpha * fitted + (1 - alpha) * old_filtered
    image = np.log1p(64 * np.where(mask, filtered * albedo, moving.noisy)) / np.log(65)
    if state is not None:
        h, w, _ = image.shape
        y, x = np.mgrid[:h, :w]
        px, py = x + motion[..., 0], y + motion[..., 1]
        inside = (px >= 0) & (px <= w - 1) & (py >= 0) & (py <= h - 1)
        everywhere = np.ones((h, w)), np.ones((h, w, 1))
        moved = twins.gather(
            state["image"], twins.surface_taps(motion, everywhere, everywhere, 0.0)
        )
        image = np.where(inside[..., None], twins.antialias(image, moved, 0.2), image)
    state = {"light": light, "filtered": filtered, "length": length, "image": image}
    return np.expm1(image * np.log(65)) / 64, state | {"surface": now}


def outshines(brightness: np.ndarray, known: np.ndarray) -> np.ndarray:
    """16 times the geometric mean over 16 x 16 tiles, each the mean of its known pixels."""
    logs = []
    for y in range(0, len(brightness), 16):
        for x in range(0, len(brightness[0]), 16):
            tile, counted = (part[y : y + 16, x : x + 16] for part in (brightness, known[..., 0]))
            logs += [np.log(tile[counted].mean())] if counted.any() else []
    return (brightness > 16 * np.exp(np.mean(logs)))[..., None]


def test_a_lamp_that_reflects_does_not_light_the_wall_around_it():
    """Nor in the history of a moving camera."""
    lamp = torch.zeros(1, 1, 32, 32, dtype=torch.bool)
    lamp[..., 10:14, 10:14] = True
    radiance = torch.where(lamp, 20.0, torch.full((1, 3, 32, 32), 0.5))
    albedo = torch.where(lamp, 0.05, torch.full((1, 3, 32, 32), 0.5))
    gbuffers = [GBuffer({**frame(i).gbuffer.buffers, "albedo": albedo}) for i in range(FRAMES)]
    image = run([Moving(gbuffer, radiance) for gbuffer in gbuffers], alpha_image=1.0)[-1]
    wall = (surface_of(gbuffers[-1])[0] & ~lamp).expand_as(image)
    # the albedo of an area jumps beside the lamp
    torch.testing.assert_close(image[wall], radiance[wall], rtol=0, atol=0.15)
    lamp = lamp.expand_as(image)
    torch.testing.assert_close(image[lamp], radiance[lamp])


def test_a_point_far_away_leaves_the_fit_finite():
    depth = torch.full((1, 1, 32, 32), 5.0)
    depth[..., 7, 9] = 1e30
    features = stack_features(torch.ones(1, 3, 32, 32) / 3**0.5, depth)
    light, surface = random_tensor(1, 3, 32, 32), depth > 0
    assert fit_blocks(light, features, surface, torch.tensor([0]), noise=0.01).isfinite().all()


def test_antialiasing_is_that_of_loops_and_keeps_what_is_new():
    image, previous = random_tensor(1, 3, 9, 11), random_tensor(1, 3, 9, 11, seed=1)
    valid = random_tensor(1, 1, 9, 11, seed=2) > 0.5
    found = antialias(image, previous, valid, 0.2)
    expected = twins.antialias(array(image), array(previous), 0.2)
    expected = np.where(array(valid) > 0, expected, array(image))
    np.testing.assert_allclose(array(found), expected, atol=1e-6)


def test_taps_on_the_surface_are_those_of_loops():
    first, second = frame(0), frame(1)
    (_, *before), (_, *now) = surface_of(first.gbuffer), surface_of(second.gbuffer)
    taps = find_surface_taps(second.gbuffer.motion, tuple(now), tuple(before), 0.9)
    pairs = [(array(depth)[..., 0], array(normal)) for depth, normal in (now, before)]
    expected = twins.surface_taps(second.arrays[3], *pairs, 0.9)
    image = random_tensor(1, 5, 32, 32)
    np.testing.assert_allclose(
        array(taps.gather(image)), twins.gather(array(image), expected), atol=1e-6
    )
    assert 0 < int(taps.valid.sum()) < taps.valid.numel()


def test_nothing_that_moves_is_the_same_as_no_motion():
    still = [find_surface_taps(m, FLAT, FLAT, 0.9) for m in (None, torch.zeros(1, 2, 5, 7))]
    image = random_tensor(1, 3, 5, 7)
    assert all(torch.equal(taps.gather(image), image) for taps in still)


@pytest.mark.parametrize("offset", [-1e30, 100.0, float("nan"), float("inf")])
def test_motion_from_outside_gives_no_taps(offset):
    taps = find_surface_taps(torch.full((1, 2, 5, 7), offset), FLAT, FLAT, 0.9)
    assert not taps.valid.any()


def test_holes_are_filled_with_the_light_around_them():
    """A grey wall in even light, of which three quarters have no sample."""
    moving = frame(0)
    ones = torch.ones_like(moving.radiance)
    gbuffer = GBuffer({**moving.gbuffer.buffers, "albedo": 0.5 * ones})
    counts = (random_tensor(1, 1, 32, 32) < 0.25).long()
    samples = Samples((ones * counts)[:, None], counts)
    method = build("filled", CPU, None)
    image, _ = method.denoise(gbuffer, samples, method.start(Size(1, 32, 32)))
    wall = surface_of(gbuffer)[0].expand_as(image)
    torch.testing.assert_close(image[wall], ones[wall], rtol=1e-2, atol=1e-2)  # noise of features
