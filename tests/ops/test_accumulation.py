"""Accumulated radiance: its mean and weight, the filling of holes, and what of it remains."""

from __future__ import annotations

import pytest
import torch

from methods.ours.history import radiance_statistics
from methods.ours.method import build
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops import (
    find_static_pixels,
    log_forward,
    repair_spp,
    reproject_radiance,
    weigh_by_similarity,
)
from rlbench.ops.accumulation import (
    AccumulatedRadiance,
    accumulate,
    feature_similarity,
    fill_holes,
    frame_radiance,
    is_cut,
    surface_features,
)
from rlbench.ops.color import luminance
from rlbench.ops.reprojection import reproject, reproject_bicubic

SIZE = (1, 40, 56)


def random_samples(seed: int, most: int = 4) -> Samples:
    """Exponential noise, with 0 to `most` samples per pixel."""
    n, h, w = SIZE
    generator = torch.Generator().manual_seed(seed)
    radiance = torch.empty(n, 8, 3, h, w).exponential_(generator=generator)
    counts = torch.randint(0, most + 1, (n, 1, h, w), generator=generator)
    samples = Samples(radiance, counts)
    return Samples(radiance.where(samples.valid_mask, 0.0), counts)


def random_radiance(seed: int) -> AccumulatedRadiance:
    samples = random_samples(seed)
    return frame_radiance(samples.radiance, samples.counts)


def test_with_full_trust_it_is_the_mean_of_the_samples_of_all_frames():
    frames = [random_samples(seed) for seed in range(5)]
    radiance = frame_radiance(frames[0].radiance, frames[0].counts)
    for samples in frames[1:]:
        new = frame_radiance(samples.radiance, samples.counts)
        radiance = accumulate(radiance, new, torch.ones_like(radiance.accumulated_spp))
    counts = sum(samples.counts for samples in frames)
    total = sum(samples.radiance.sum(1) for samples in frames)
    squares = sum(luminance(samples.radiance).square().sum(1) for samples in frames)
    expected = AccumulatedRadiance(
        total / counts.clamp_min(1), squares / counts.clamp_min(1), counts.float()
    )
    for part, expected_part in zip(radiance, expected, strict=True):
        torch.testing.assert_close(part, expected_part, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("trust", [0.0, 0.25, 0.7])
def test_the_weight_of_equal_frames_is_a_geometric_series(trust):
    new = frame_radiance(torch.ones(1, 8, 3, 2, 2), torch.full((1, 1, 2, 2), 8))
    radiance = new
    for _ in range(60):
        radiance = accumulate(radiance, new, torch.full_like(radiance.accumulated_spp, trust))
    torch.testing.assert_close(
        radiance.accumulated_spp, torch.full_like(radiance.accumulated_spp, 8 / (1 - trust))
    )
    torch.testing.assert_close(radiance.mean, new.mean)


def test_without_trust_it_is_the_new_frame():
    old, new = random_radiance(0), random_radiance(1)
    total = accumulate(old, new, torch.zeros_like(old.accumulated_spp))
    sampled = new.accumulated_spp > 0
    torch.testing.assert_close(total.mean.where(sampled, 0.0), new.mean.where(sampled, 0.0))
    assert torch.equal(total.accumulated_spp, new.accumulated_spp)


def test_a_pixel_without_new_samples_keeps_its_radiance():
    old = random_radiance(0)
    none = frame_radiance(torch.zeros(1, 8, 3, *SIZE[1:]), torch.zeros(1, 1, *SIZE[1:]).long())
    total = accumulate(old, none, torch.ones_like(old.accumulated_spp))
    for before, after in zip(old, total, strict=True):
        assert torch.equal(before, after)


@pytest.mark.parametrize("weight", [1e-9, 1e-7, 1e-5])
def test_a_history_of_hardly_any_weight_never_darkens_a_pixel(weight):
    """Without new samples the pixel keeps its light, or is a hole that takes its neighbours'."""
    light = torch.full((1, 3, 8, 8), 5.0)
    spp = torch.ones(1, 1, 8, 8)
    spp[..., 4, 4] = weight
    square = luminance(light)[:, None].square()
    new = AccumulatedRadiance(torch.zeros_like(light), torch.zeros_like(square), 0 * spp)
    kept = accumulate(AccumulatedRadiance(light, square, spp), new, torch.ones_like(spp))
    filled = fill_holes(kept, torch.ones_like(light))
    torch.testing.assert_close(filled.mean, light)


def test_filling_holes_leaves_sampled_pixels_unchanged():
    radiance = random_radiance(3)
    albedo = torch.rand(1, 3, *SIZE[1:], generator=torch.Generator().manual_seed(1))
    sampled = (radiance.accumulated_spp > 0).expand(-1, 3, -1, -1)
    filled = fill_holes(radiance, albedo)
    assert torch.equal(filled.mean[sampled], radiance.mean[sampled])
    assert torch.equal(filled.second_moment[sampled[:, :1]], radiance.second_moment[sampled[:, :1]])
    assert torch.equal(filled.accumulated_spp, radiance.accumulated_spp)


@pytest.mark.parametrize("share", [0.5, 0.02, 1 / 2240])
def test_holes_under_even_light_show_the_texture(share):
    """2240 pixels: at the last share one pixel is sampled, and all others are one hole."""
    generator = torch.Generator().manual_seed(2)
    albedo = 0.1 + 0.8 * torch.rand(1, 3, *SIZE[1:], generator=generator)
    image = 2.5 * (albedo + 0.01)  # light of 2.5 on the demodulation albedo
    order = torch.rand(1, 1, *SIZE[1:], generator=generator).flatten().argsort().view(1, 1, 40, 56)
    weight = (order < share * 2240).float()
    radiance = AccumulatedRadiance(image * weight, torch.zeros_like(weight), weight)
    filled = fill_holes(radiance, albedo)
    torch.testing.assert_close(filled.mean, image, rtol=1e-4, atol=1e-5)
    deviation = radiance_statistics(filled)[:, :1]
    assert not deviation.where(weight == 0, 0.0).gt(0.1).any()  # holes claim none


def test_a_frame_without_any_sample_is_black():
    zero = torch.zeros(1, 1, *SIZE[1:])
    nothing = AccumulatedRadiance(zero.expand(-1, 3, -1, -1), zero, zero)
    assert not any(part.any() for part in fill_holes(nothing, torch.ones(1, 3, 40, 56)))


def test_a_hole_takes_the_radiance_of_its_side_of_the_image():
    """Left dark, right bright; a hole of 4x4 pixels in each."""
    mean = torch.ones(1, 3, 64, 64)
    mean[..., 32:] = 5.0
    weight = torch.ones(1, 1, 64, 64)
    weight[..., 30:34, 8:12] = weight[..., 30:34, 52:56] = 0
    filled = fill_holes(AccumulatedRadiance(mean, weight, weight), torch.ones(1, 3, 64, 64))
    torch.testing.assert_close(filled.mean, mean)


def test_even_radiance_keeps_its_brightness_when_reprojected_beside_holes():
    """Unfilled holes would be black, and bilinear taps would mix them in."""
    (frame,) = procedural_clip(seed=3, size=Size(1, 32, 32), frames=1)
    even = {"albedo": torch.full((1, 3, 32, 32), 0.5), "motion": torch.full((1, 2, 32, 32), 0.4)}
    gbuffer = GBuffer({**frame.gbuffer.buffers, **even})
    method = build("", torch.device("cpu"), "random")
    counts = torch.zeros(1, 1, 32, 32, dtype=torch.long)
    counts[..., ::4, ::4] = 1
    samples = Samples(torch.full((1, 1, 3, 32, 32), 2.0) * counts.unsqueeze(1), counts)
    _, state = method.denoise(gbuffer, samples, method.start(Size(1, 32, 32)))
    radiance = method.reproject(gbuffer, state).radiance
    assert radiance.accumulated_spp.any()
    assert not radiance.accumulated_spp.all()
    torch.testing.assert_close(radiance.mean[..., :31, :31], torch.full((1, 3, 31, 31), 2.0))


def test_the_same_surface_has_similarity_one_and_another_has_less():
    features = torch.rand(1, 7, 5, 6, generator=torch.Generator().manual_seed(0))
    other = features.clone()
    other[:, 3:6] = 1 - other[:, 3:6]
    assert torch.equal(feature_similarity(features, features), torch.ones(1, 1, 5, 6))
    difference = (features - other)[:, 3:6].abs().sum(1, keepdim=True)
    torch.testing.assert_close(feature_similarity(features, other), torch.exp(-difference / 4))


@pytest.mark.parametrize("seed", range(4))
def test_the_frame_after_a_cut_is_found_by_its_surfaces_alone_also_with_noisy_buffers(seed):
    size, cut = Size(1, 60, 75), 2
    generator = torch.Generator().manual_seed(seed)
    features, found = [], []
    for frame in procedural_clip(seed, size, 4, cut=cut):
        albedo = frame.gbuffer.albedo
        noisy = albedo + 0.3 * torch.randn(albedo.shape, generator=generator)
        features.append(surface_features(frame.gbuffer.normal, noisy, frame.gbuffer.depth))
        if len(features) > 1:
            previous, valid = reproject(features[-2], frame.gbuffer.motion)
            found.append(bool(is_cut(features[-1], previous, valid)))
    assert found == [frame == cut for frame in (1, 2, 3)]


@pytest.mark.parametrize(("columns", "expected"), [(2, False), (3, True)])
def test_a_cut_changes_more_than_a_third_of_the_blocks(columns, expected):
    features = torch.zeros(1, 7, 48, 7 * 8)
    other = features.clone()
    other[:, 3, :, : columns * 8] = 1.0
    assert bool(is_cut(features, other, torch.ones(1, 1, 48, 56, dtype=torch.bool))) == expected


def test_an_image_without_any_valid_history_is_no_cut_and_each_image_of_a_batch_has_its_own():
    features = torch.rand(3, 7, 20, 20, generator=torch.Generator().manual_seed(0))
    other = features.clone()
    other[1:, 3:6] += 1.0
    valid = torch.ones(3, 1, 20, 20, dtype=torch.bool)
    valid[2] = False
    assert is_cut(features, other, valid).flatten().tolist() == [False, True, False]


def test_networks_read_the_relative_deviation_of_the_samples():
    """Black or white with equal chance: deviation = mean, which is half of their sum."""
    generator = torch.Generator().manual_seed(0)
    radiance = 4.0 * torch.randint(0, 2, (1, 4096, 1, 2, 2), generator=generator).float()
    samples = Samples(radiance.expand(-1, -1, 3, -1, -1), torch.full((1, 1, 2, 2), 4096))
    statistics = radiance_statistics(frame_radiance(samples.radiance, samples.counts))
    torch.testing.assert_close(statistics[:, :1], torch.full((1, 1, 2, 2), 0.5), rtol=0.03, atol=0)
    assert ((statistics >= 0) & (statistics < 1)).all()


# history


SMALL = (1, 1, 12, 10)


def test_radiance_moves_linearly_and_the_image_in_log_transfer() -> None:
    torch.manual_seed(0)
    mean = torch.rand(1, 3, 12, 10) + 0.5
    image = torch.rand(1, 3, 12, 10) + 0.5
    square = mean.square().mean(1, keepdim=True)
    motion = torch.full((1, 2, 12, 10), 0.25)
    radiance = AccumulatedRadiance(mean, square, torch.ones(SMALL))
    moved = reproject_radiance(radiance, image, motion)
    one_by_one = [reproject_bicubic(x, motion)[0] for x in (mean, square, log_forward(image))]
    for actual, expected in zip(moved, one_by_one, strict=True):
        torch.testing.assert_close(actual, expected, rtol=1e-5, atol=1e-6)  # sums in another order


def test_a_broken_moment_does_not_spread() -> None:
    mean = torch.full((1, 3, 12, 10), 0.5)
    mean[..., 5, 5] = torch.nan
    radiance = AccumulatedRadiance(mean, torch.full(SMALL, 0.25), torch.ones(SMALL))
    moved = reproject_radiance(radiance, torch.full((1, 3, 12, 10), 0.5), None)
    torch.testing.assert_close(moved[0], torch.full((1, 3, 12, 10), 0.5))


def test_a_number_that_is_no_count_is_replaced_by_a_neighbour() -> None:
    spp = torch.full(SMALL, 4.0)
    spp[..., 2, 2], spp[..., 6, 6], spp[..., 9, 9] = torch.inf, -1.0, 2e4
    assert (repair_spp(spp) == 4).all()


def test_the_weight_falls_with_similarity_and_ends_at_a_thousandth() -> None:
    similarity = torch.tensor([1.0, 0.5, 3e-4, 0.0]).view(1, 1, 1, 4)
    weight = weigh_by_similarity(torch.full((1, 1, 1, 4), 2.0), similarity)
    assert weight.flatten().tolist() == [2.0, 1.0, 0.0, 0.0]


def test_a_pixel_is_static_if_its_surface_is_the_same_and_does_not_move() -> None:
    similarity = torch.tensor([0.9, 0.9, 0.4]).view(1, 1, 1, 3)
    motion = torch.tensor([[0.0, 0.01, 0.0], [0.0005, 0.0, 0.0]]).view(1, 2, 1, 3)
    assert find_static_pixels(similarity, motion).flatten().tolist() == [True, False, False]
    assert find_static_pixels(similarity, None).flatten().tolist() == [True, True, False]
