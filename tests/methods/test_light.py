"""Light gathered over frames: closed forms of its mean, its weight, and what fills its holes."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from methods.ours.accumulation import (
    AccumulatedRadiance,
    accumulate,
    feature_similarity,
    fill_holes,
    frame_radiance,
    network_features,
)
from methods.ours.method import build
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import GBuffer, Samples, Size

SIZE = (1, 40, 56)


def drawn(seed: int, most: int = 4) -> Samples:
    """Exponential noise, between none and `most` samples a pixel."""
    n, h, w = SIZE
    generator = torch.Generator().manual_seed(seed)
    radiance = torch.empty(n, 8, 3, h, w).exponential_(generator=generator)
    counts = torch.randint(0, most + 1, (n, 1, h, w), generator=generator)
    samples = Samples(radiance, counts)
    return Samples(radiance.where(samples.valid_mask, 0.0), counts)


def luminance(radiance: Tensor) -> Tensor:
    red, green, blue = radiance.unbind(-3)
    return (0.212671 * red + 0.715160 * green + 0.072169 * blue).unsqueeze(-3)


def test_with_full_trust_it_is_the_mean_of_all_samples_of_all_frames():
    frames = [drawn(seed) for seed in range(5)]
    light = frame_radiance(frames[0])
    for samples in frames[1:]:
        light = accumulate(light, frame_radiance(samples), torch.ones_like(light.accumulated_spp))
    counts = sum(samples.counts for samples in frames)
    total = sum(samples.radiance.sum(1) for samples in frames)
    squares = sum(luminance(samples.radiance).square().sum(1) for samples in frames)
    expected = AccumulatedRadiance(
        total / counts.clamp_min(1), squares / counts.clamp_min(1), counts.float()
    )
    for found, wanted in zip(light, expected, strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("trust", [0.0, 0.25, 0.7])
def test_the_weight_of_equal_frames_is_a_geometric_series(trust):
    new = frame_radiance(Samples(torch.ones(1, 8, 3, 2, 2), torch.full((1, 1, 2, 2), 8)))
    light = new
    for _ in range(60):
        light = accumulate(light, new, torch.full_like(light.accumulated_spp, trust))
    torch.testing.assert_close(
        light.accumulated_spp, torch.full_like(light.accumulated_spp, 8 / (1 - trust))
    )
    torch.testing.assert_close(light.mean, new.mean)


def test_without_trust_it_is_the_new_frame():
    old, new = frame_radiance(drawn(0)), frame_radiance(drawn(1))
    found = accumulate(old, new, torch.zeros_like(old.accumulated_spp))
    there = new.accumulated_spp > 0
    torch.testing.assert_close(found.mean.where(there, 0.0), new.mean.where(there, 0.0))
    assert torch.equal(found.accumulated_spp, new.accumulated_spp)


def test_a_pixel_without_new_samples_keeps_its_light():
    old = frame_radiance(drawn(0))
    none = frame_radiance(
        Samples(torch.zeros(1, 8, 3, *SIZE[1:]), torch.zeros(1, 1, *SIZE[1:]).long())
    )
    found = accumulate(old, none, torch.ones_like(old.accumulated_spp))
    for before, after in zip(old, found, strict=True):
        assert torch.equal(before, after)


def test_what_was_sampled_is_shown_as_it_is():
    light = frame_radiance(drawn(3))
    albedo = torch.rand(1, 3, *SIZE[1:], generator=torch.Generator().manual_seed(1))
    there = (light.accumulated_spp > 0).expand(-1, 3, -1, -1)
    shown = fill_holes(light, albedo)
    assert torch.equal(shown.mean[there], light.mean[there])
    assert torch.equal(shown.second_moment[there[:, :1]], light.second_moment[there[:, :1]])
    assert torch.equal(shown.accumulated_spp, light.accumulated_spp)


@pytest.mark.parametrize("share", [0.5, 0.02, 1 / 2240])
def test_holes_in_even_light_show_the_texture_under_that_light(share):
    """2240 pixels: at the last share there is one sampled pixel, and the whole image is a hole."""
    generator = torch.Generator().manual_seed(2)
    albedo = 0.1 + 0.8 * torch.rand(1, 3, *SIZE[1:], generator=generator)
    image = 2.5 * (albedo + 0.01)  # light of 2.5 on what networks have it multiplied by
    order = torch.rand(1, 1, *SIZE[1:], generator=generator).flatten().argsort().view(1, 1, 40, 56)
    weight = (order < share * 2240).float()
    light = AccumulatedRadiance(image * weight, torch.zeros_like(weight), weight)
    shown = fill_holes(light, albedo)
    torch.testing.assert_close(shown.mean, image, rtol=1e-4, atol=1e-5)
    assert (
        not network_features(shown)[:, 3:4].where(weight == 0, 0.0).gt(0.1).any()
    )  # no spread is claimed


def test_a_frame_without_any_sample_is_black():
    zero = torch.zeros(1, 1, *SIZE[1:])
    nothing = AccumulatedRadiance(zero.expand(-1, 3, -1, -1), zero, zero)
    assert not any(part.any() for part in fill_holes(nothing, torch.ones(1, 3, 40, 56)))


def test_a_hole_takes_the_light_of_its_side_of_the_image():
    """Left dark, right bright; a hole of 4x4 pixels in each."""
    mean = torch.ones(1, 3, 64, 64)
    mean[..., 32:] = 5.0
    weight = torch.ones(1, 1, 64, 64)
    weight[..., 30:34, 8:12] = weight[..., 30:34, 52:56] = 0
    shown = fill_holes(AccumulatedRadiance(mean, weight, weight), torch.ones(1, 3, 64, 64))
    torch.testing.assert_close(shown.mean, mean)


def test_even_light_stays_as_bright_as_it_is_where_it_is_moved_beside_holes():
    """What had no sample would be black, and taps between pixels would mix it in."""
    (frame,) = procedural(seed=3, size=Size(1, 32, 32), frames=1)
    even = {"albedo": torch.full((1, 3, 32, 32), 0.5), "motion": torch.full((1, 2, 32, 32), 0.4)}
    gbuffer, method = (
        GBuffer({**frame.gbuffer.buffers, **even}),
        build("", torch.device("cpu"), "random"),
    )
    counts = torch.zeros(1, 1, 32, 32, dtype=torch.long)
    counts[..., ::4, ::4] = 1
    samples = Samples(torch.full((1, 1, 3, 32, 32), 2.0) * counts.unsqueeze(1), counts)
    _, left = method.denoise(gbuffer, samples, method.start(Size(1, 32, 32)))
    moved = method.known(gbuffer, left).moved
    assert moved.light.accumulated_spp.any()
    assert not moved.light.accumulated_spp.all()
    torch.testing.assert_close(moved.light.mean[..., :31, :31], torch.full((1, 3, 31, 31), 2.0))


def test_the_same_surface_is_alike_and_another_is_not():
    seen = torch.rand(1, 7, 5, 6, generator=torch.Generator().manual_seed(0))
    other = seen.clone()
    other[:, 3:6] = 1 - other[:, 3:6]
    assert torch.equal(feature_similarity(seen, seen), torch.ones(1, 1, 5, 6))
    difference = (seen - other)[:, 3:6].abs().sum(1, keepdim=True)
    torch.testing.assert_close(feature_similarity(seen, other), torch.exp(-2 * difference))


def test_the_spread_that_networks_see_is_that_of_the_samples():
    """Black or white by equal chance: deviation = mean, so half of their sum, over many samples."""
    generator = torch.Generator().manual_seed(0)
    radiance = 4.0 * torch.randint(0, 2, (1, 4096, 1, 2, 2), generator=generator).float()
    samples = Samples(radiance.expand(-1, -1, 3, -1, -1), torch.full((1, 1, 2, 2), 4096))
    seen = network_features(frame_radiance(samples))
    torch.testing.assert_close(seen[:, 3:4], torch.full((1, 1, 2, 2), 0.5), rtol=0.03, atol=0)
    assert (seen >= 0).all()
    assert (seen[:, 3:] < 1).all()
