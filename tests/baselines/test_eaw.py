"""EAW: equal to plain loops; edges, constant irradiance, and the search for filter widths."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from baselines.eaw import search
from baselines.eaw.method import Config, Eaw, atrous_pass
from rlbench.clips.stored import open_clip
from rlbench.frames import GBuffer, Samples
from rlbench.ops.demodulation import reflectance
from rlbench.ops.padded_rows import PaddedRows
from tests.baselines import wavelet_twins
from tests.baselines.moving import frame


def denoise(gbuffer: GBuffer, radiance: Tensor, config: Config = Config()) -> Tensor:  # noqa: B008
    n, _, h, w = radiance.shape
    samples = Samples(radiance[:, None], torch.ones(n, 1, h, w, dtype=torch.int64))
    return Eaw(config).denoise(gbuffer, samples, None)[0]


@pytest.mark.parametrize(
    "config", [Config(), Config(phi_color=1.0, phi_normal=0.02, phi_depth=1e-2)], ids=str
)
def test_a_frame_equals_plain_loops(config):
    moving = frame(0)
    image = denoise(moving.gbuffer, moving.radiance, config)[0].permute(1, 2, 0)
    expected = wavelet_twins.eaw(
        moving.noisy, moving.arrays, config.phi_color, config.phi_normal, config.phi_depth
    )
    # float32 logarithms of radiance up to 4000 are halved in width, and squared
    np.testing.assert_allclose(image, expected, rtol=1e-3, atol=1e-5)


@given(seed=st.integers(0, 9), light=st.floats(0, 100))
@settings(max_examples=5, deadline=None)
def test_constant_irradiance_is_unchanged(seed, light):
    """For any texture and geometry."""
    gbuffer = frame(seed).gbuffer
    lit = light * reflectance(gbuffer.albedo)
    torch.testing.assert_close(denoise(gbuffer, lit), lit, rtol=1e-5, atol=1e-6)  # float32 sums


def test_infinite_widths_give_the_spline_of_each_pass():
    """Two dilated convolutions, compared away from the border."""
    wide = Config(passes=2, phi_color=1e12, phi_normal=1e12, phi_depth=1e12)
    radiance = torch.rand(1, 3, 17, 19, generator=torch.Generator().manual_seed(0))
    buffers = {"albedo": torch.ones_like(radiance), "normal": torch.ones_like(radiance)}
    gbuffer = GBuffer({**buffers, "depth": torch.ones(1, 1, 17, 19)})
    kernel = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    kernel = (kernel[:, None] * kernel).expand(3, 1, 5, 5)
    once = torch.nn.functional.conv2d(radiance, kernel, groups=3)
    expected = torch.nn.functional.conv2d(once, kernel, groups=3, dilation=2)
    image = denoise(gbuffer, radiance, wide)[..., 6:-6, 6:-6]
    torch.testing.assert_close(image, expected, rtol=1e-5, atol=1e-6)  # float32 sums


def test_background_and_emitters_are_not_filtered():
    moving = frame(0)
    unfiltered = (moving.gbuffer.albedo == 0).all(1, keepdim=True).expand_as(moving.radiance)
    assert unfiltered.any()
    assert torch.equal(
        denoise(moving.gbuffer, moving.radiance)[unfiltered], moving.radiance[unfiltered]
    )


def test_a_depth_edge_is_preserved():
    half = torch.arange(16) < 8
    radiance = torch.where(half, 1.0, 5.0).expand(1, 3, 16, 16)
    depth = torch.where(half, 2.0, 4.0).expand(1, 1, 16, 16)
    gbuffer = GBuffer(
        {"albedo": torch.ones(1, 3, 16, 16), "normal": torch.ones(1, 3, 16, 16), "depth": depth}
    )
    torch.testing.assert_close(denoise(gbuffer, radiance), radiance)


def test_a_pass_filters_images_of_a_batch_independently():
    source = torch.Generator().manual_seed(0)
    features, irradiance = (torch.rand(2, c, 9, 11, generator=source) for c in (7, 3))

    def filter_images(images: slice) -> Tensor:
        rows = PaddedRows(len(features[images]), 9, 11, margin=4)
        return rows.unpack(
            atrous_pass(
                rows, 2, rows.pack(features[images], fill=1e4), rows.pack(irradiance[images])
            )
        )

    single = torch.cat((filter_images(slice(0, 1)), filter_images(slice(1, 2))))
    torch.testing.assert_close(filter_images(slice(0, 2)), single)


@pytest.mark.parametrize("step", [1, 4])
def test_chunks_of_a_row_do_not_change_a_bit(monkeypatch, step):
    """Else a window of an image would differ from the image."""
    source = torch.Generator().manual_seed(0)
    features, irradiance = (torch.rand(1, c, 40, 50, generator=source) for c in (7, 3))
    rows = PaddedRows(1, 40, 50, margin=8)
    packed = rows.pack(features, fill=1e4), rows.pack(irradiance)
    images = []
    for size in (1 << 16, 700, 130):
        monkeypatch.setattr("rlbench.ops.padded_rows.CHUNK_PIXELS", size)
        images.append(rows.unpack(atrous_pass(rows, step, *packed)))
    assert torch.equal(images[0], images[1])
    assert torch.equal(images[0], images[2])


def test_the_search_returns_the_best_config_first(clip_folder):
    """On noise around a smooth image, the wider filter is better."""
    narrow, wide = Config(phi_color=1e-3), Config(phi_color=100.0)
    scores = search.search([open_clip(clip_folder)], [narrow, wide])
    assert list(scores) == [wide, narrow]
    assert scores[wide] > scores[narrow] + 3
