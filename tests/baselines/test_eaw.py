"""EAW: equal to its twin in loops; what it keeps, what it mixes, and how its widths are chosen."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from baselines.eaw import search
from baselines.eaw.method import Config, Eaw, smooth
from rlbench.clips.stored import open_clip
from rlbench.frames import GBuffer, Samples
from rlbench.ops.demodulation import reflectance
from rlbench.ops.padded_rows import PaddedRows
from tests.baselines import wavelet_twins
from tests.baselines.moving import frame


def shown(gbuffer: GBuffer, radiance: Tensor, config: Config = Config()) -> Tensor:  # noqa: B008
    n, _, h, w = radiance.shape
    samples = Samples(radiance[:, None], torch.ones(n, 1, h, w, dtype=torch.int64))
    return Eaw(config).denoise(gbuffer, samples, None)[0]


def test_metadata_is_readable_without_torch():
    code = "import sys, baselines.eaw; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("config", [Config(), Config(light=1.0, normal=0.02, depth=1e-2)], ids=str)
def test_a_frame_equals_its_twin_in_loops(config):
    each = frame(0)
    image = shown(each.gbuffer, each.radiance, config)[0].permute(1, 2, 0)
    expected = wavelet_twins.eaw(each.noisy, each.arrays, config.light, config.normal, config.depth)
    # float32 logarithms of radiance up to 4000 are halved in width, and squared
    np.testing.assert_allclose(image, expected, rtol=1e-3, atol=1e-5)


@given(seed=st.integers(0, 9), light=st.floats(0, 100))
@settings(max_examples=5, deadline=None)
def test_constant_irradiance_stays_as_it_is(seed, light):
    """Whatever the texture and the shapes."""
    gbuffer = frame(seed).gbuffer
    lit = light * reflectance(gbuffer.albedo)
    torch.testing.assert_close(shown(gbuffer, lit), lit, rtol=1e-5, atol=1e-6)  # float32 sums


def test_infinite_widths_give_the_spline_of_each_pass():
    """Five dilated convolutions, on an image that repeats its middle column: no border matters."""
    wide = replace(Config(), passes=2, light=1e12, normal=1e12, depth=1e12)
    radiance = torch.rand(1, 3, 17, 19, generator=torch.Generator().manual_seed(0))
    flat = {"albedo": torch.ones_like(radiance), "normal": torch.ones_like(radiance)}
    gbuffer = GBuffer({**flat, "depth": torch.ones(1, 1, 17, 19)})
    kernel = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    kernel = (kernel[:, None] * kernel).expand(3, 1, 5, 5)
    once = torch.nn.functional.conv2d(radiance, kernel, groups=3)
    expected = torch.nn.functional.conv2d(once, kernel, groups=3, dilation=2)
    found = shown(gbuffer, radiance, wide)[..., 6:-6, 6:-6]
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)  # float32 sums


def test_background_and_lamps_pass_through():
    each = frame(0)
    through = (each.gbuffer.albedo == 0).all(1, keepdim=True).expand_as(each.radiance)
    assert through.any()
    assert torch.equal(shown(each.gbuffer, each.radiance)[through], each.radiance[through])


def test_an_edge_of_depth_is_not_crossed():
    half = torch.arange(16) < 8
    radiance = torch.where(half, 1.0, 5.0).expand(1, 3, 16, 16)
    depth = torch.where(half, 2.0, 4.0).expand(1, 1, 16, 16)
    gbuffer = GBuffer(
        {"albedo": torch.ones(1, 3, 16, 16), "normal": torch.ones(1, 3, 16, 16), "depth": depth}
    )
    torch.testing.assert_close(shown(gbuffer, radiance), radiance)


def test_a_pass_treats_two_images_as_each_alone():
    source = torch.Generator().manual_seed(0)
    guide, light = (torch.rand(2, c, 9, 11, generator=source) for c in (7, 3))

    def passed(some: slice) -> Tensor:
        flat = PaddedRows(len(guide[some]), 9, 11, margin=4)
        return flat.unpack(
            smooth(flat, 2, flat.pack(guide[some], fill=1e4), flat.pack(light[some]))
        )

    alone = torch.cat((passed(slice(0, 1)), passed(slice(1, 2))))
    torch.testing.assert_close(passed(slice(0, 2)), alone)


def test_the_search_finds_the_best_of_its_grid_first(clip_folder):
    """On noise around a smooth picture, the wider filter is better."""
    narrow, wide = Config(light=1e-3), Config(light=100.0)
    found = search.search([open_clip(clip_folder)], [narrow, wide])
    assert list(found) == [wide, narrow]
    assert found[wide] > found[narrow] + 3


def test_the_widths_that_are_used_are_in_the_grid():
    assert Config() in search.GRID
