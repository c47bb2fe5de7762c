"""Radiance history: what is reprojected, what counts as static, and which weights remain."""

from __future__ import annotations

import torch

from rlbench.ops import (
    AccumulatedRadiance,
    find_static_pixels,
    log_forward,
    repair_spp,
    reproject_bicubic,
    reproject_radiance,
    weigh_by_similarity,
)

SHAPE = (1, 1, 12, 10)


def test_radiance_moves_linearly_and_the_image_in_log_transfer() -> None:
    torch.manual_seed(0)
    mean = torch.rand(1, 3, 12, 10) + 0.5
    image = torch.rand(1, 3, 12, 10) + 0.5
    square = mean.square().mean(1, keepdim=True)
    motion = torch.full((1, 2, 12, 10), 0.25)
    radiance = AccumulatedRadiance(mean, square, torch.ones(SHAPE))
    moved = reproject_radiance(radiance, image, motion)
    one_by_one = [reproject_bicubic(x, motion)[0] for x in (mean, square, log_forward(image))]
    for actual, expected in zip(moved, one_by_one, strict=True):
        torch.testing.assert_close(actual, expected, rtol=1e-5, atol=1e-6)  # sums in another order


def test_a_broken_moment_does_not_spread() -> None:
    mean = torch.full((1, 3, 12, 10), 0.5)
    mean[..., 5, 5] = torch.nan
    radiance = AccumulatedRadiance(mean, torch.full(SHAPE, 0.25), torch.ones(SHAPE))
    moved = reproject_radiance(radiance, torch.full((1, 3, 12, 10), 0.5), None)
    torch.testing.assert_close(moved[0], torch.full((1, 3, 12, 10), 0.5))


def test_a_number_that_is_no_count_is_replaced_by_a_neighbour() -> None:
    spp = torch.full(SHAPE, 4.0)
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
