"""Noise, the reference, depth and normals, against known answers."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from rlbench.apps.dumps.lint.checks import fit_depth
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.apps.dumps.lint.geometry import VIEW_DEPTH, fit_rotation
from rlbench.apps.dumps.lint.radiance import (
    bounded_noise,
    check_halves,
    check_noise_ceiling,
    correlate,
    half_noise_ratio,
    noise_ceiling_db,
    ratio_of_sums,
)
from tests.apps.dumps.lint.broken_fixtures import correct_clip


def test_independent_samples_correlate_by_one_over_the_others():
    generator = torch.Generator().manual_seed(0)
    pool = torch.randn(2, 8, 3, 64, 64, generator=generator).exp()
    noise = bounded_noise(pool)
    found, error = correlate(noise[:, 2], noise[:, 5])
    assert found == pytest.approx(-1 / 7, abs=4 * error)
    assert error < 0.02


def test_the_error_of_a_ratio_is_its_scatter_over_seeds():
    generator = torch.Generator().manual_seed(0)
    pairs = [torch.rand(2, 1, 3, 64, 64, generator=generator) for _ in range(60)]
    found = torch.tensor([ratio_of_sums(upper, lower) for upper, lower in pairs])
    # 60 draws give a standard deviation to within 1 / sqrt(120), 9 %; three times that
    assert float(found[:, 0].std() / found[:, 1].mean()) == pytest.approx(1, abs=0.28)


def test_an_unknown_reference_spp_predicts_no_noise(arrays):
    header = replace(arrays.header, reference_spp=(0,) * len(arrays))
    results = [
        check(replace(arrays, header=header)) for check in (check_halves, check_noise_ceiling)
    ]
    assert all("reference_spp is not known" in result.found for result in results)


def test_the_noise_ceiling_is_the_psnr_of_noise_of_that_size():
    generator = torch.Generator().manual_seed(0)
    still = correct_clip(frames=1, half=1)
    shade = torch.full((1, 3, 72, 96), 0.25)
    noisy = [shade + 0.01 * torch.randn(shade.shape, generator=generator) for _ in "AB"]
    arrays = ClipArrays(replace(still.header, exposure=1.0), {}, {}, *noisy)
    slope = 1.055 / 2.4 * 0.25 ** (1 / 2.4 - 1)  # of the sRGB curve, by hand
    expected = -20 * math.log10(slope * 0.01 / math.sqrt(2))
    assert noise_ceiling_db(arrays) == pytest.approx(expected, abs=0.2)


def test_halves_that_share_half_of_their_noise_have_half_the_difference(arrays):
    own = half_noise_ratio(arrays)[0]
    noise = arrays.half_b - arrays.half_a
    # b' = a + noise / sqrt(2) differs from a by half the variance
    closer = replace(arrays, half_b=arrays.half_a + noise / math.sqrt(2))
    assert half_noise_ratio(closer)[0] == pytest.approx(own / 2, rel=0.1)  # weights move a little


# Geometry


def test_depth_and_normals_give_the_field_of_view_of_the_camera(arrays):
    fit = fit_depth(arrays)[VIEW_DEPTH]
    gbuffer = math.degrees(2 * math.atan(0.5 / fit.focal))
    assert gbuffer == pytest.approx(60, abs=3)  # the search's last step is 5 % of the focal length


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_rotation_is_fitted_despite_outliers(mirror):
    generator = torch.Generator().manual_seed(0)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    turn = turn * torch.linalg.det(turn) * mirror
    source = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=1)
    target = source @ turn.T
    target[:100] = target[:100].roll(1, 0)
    torch.testing.assert_close(
        fit_rotation(source, target)[0], turn, atol=0.01, rtol=0
    )  # a fifth lies
