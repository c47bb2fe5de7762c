"""EAW: equal to plain loops; edges and widths; what still pixels keep, and when they begin anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from baselines.eaw import search
from baselines.eaw.method import MAX_SPP, Config, Eaw, Still, StillPixels, atrous_pass
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.clips.stored import open_clip
from rlbench.frames import Frame, GBuffer, Samples, Size
from rlbench.ops.demodulation import reflectance
from rlbench.ops.padded_rows import PaddedRows
from rlbench.run import FrameResult, run_clip
from tests.baselines import wavelet_twins
from tests.baselines.moving import frame
from tests.baselines.noise import array, one_sample, random_tensor, wall


def denoise(gbuffer: GBuffer, radiance: Tensor, config: Config = Config()) -> Tensor:  # noqa: B008
    return Eaw(config).denoise(gbuffer, one_sample(radiance), None)[0]


@pytest.fixture(params=[False, True], ids=["taps", "windows"])
def either_form(request, monkeypatch):
    """Taps in place, or windows as torch.compile sees them."""
    monkeypatch.setattr("baselines.eaw.method.is_compiling", lambda: request.param)


@pytest.mark.usefixtures("either_form")
@pytest.mark.parametrize(
    "config", [Config(), Config(phi_color=1.0, phi_normal=0.02, phi_depth=1e-2)], ids=str
)
def test_a_frame_equals_plain_loops(config):
    moving = frame(0)
    image = array(denoise(moving.gbuffer, moving.radiance, config))
    expected = wavelet_twins.eaw(
        moving.noisy, moving.arrays, config.phi_color, config.phi_normal, config.phi_depth
    )
    # float32 logarithms of radiance up to 4000 are halved in width, and squared
    np.testing.assert_allclose(image, expected, rtol=1e-3, atol=1e-5)


@given(seed=st.integers(0, 9), light=st.floats(0, 100))
@settings(max_examples=5)
def test_constant_irradiance_is_unchanged(seed, light):
    """For any texture and geometry."""
    gbuffer = frame(seed).gbuffer
    lit = light * reflectance(gbuffer.albedo)
    torch.testing.assert_close(denoise(gbuffer, lit), lit, rtol=1e-5, atol=1e-6)  # float32 sums


@pytest.mark.parametrize("step", [1, 4])
def test_chunks_of_a_row_do_not_change_a_bit(monkeypatch, step):
    """Else a window of an image would differ from the image."""
    rows, images = PaddedRows(1, 40, 50, margin=8), []
    features, irradiance = random_tensor(1, 7, 40, 50), random_tensor(1, 3, 40, 50, seed=1)
    packed = rows.pack(features, fill=1e4), rows.pack(irradiance)
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


# still pixels

SIDE = 128  # 16 blocks, one of which has its turn in each frame


def run_still(frames: int, spp: float = 0.25, **options: bool) -> list[FrameResult]:
    clip = procedural_clip(3, Size(1, SIDE, SIDE), frames, 8, **options)
    return list(run_clip(Still(), clip, spp))


def moved(frame: Frame) -> Tensor:
    return frame.gbuffer.motion.abs().amax(1, keepdim=True) > 1e-3


def test_a_still_pixel_holds_the_mean_of_all_its_samples():
    frames = run_still(4, static=True)
    total = sum(result.samples.radiance.double().sum(1) for result in frames)
    counts = sum(result.samples.counts for result in frames)
    last = frames[-1].state
    assert torch.equal(last.spp, counts.float())
    expected = (total / counts.clamp_min(1)).float()
    torch.testing.assert_close(last.radiance, expected, rtol=1e-5, atol=1e-6)  # float32 sums


def test_a_pixel_that_moves_begins_anew_and_the_others_do_not():
    first, second = run_still(2, still_camera=True)
    anew = moved(second.frame)
    assert torch.equal(second.state.spp[anew], second.samples.counts[anew].float())
    counts = first.samples.counts + second.samples.counts
    disoccluded = (second.state.surface != first.state.surface).any(1, keepdim=True)
    kept = ~anew & ~disoccluded
    assert kept.float().mean() > 0.5
    assert torch.equal(second.state.spp[kept], counts[kept].float())


def test_half_of_the_budget_goes_to_what_moves_and_half_to_the_blocks_whose_turn_it_is():
    second = run_still(2, still_camera=True)[1]
    counts, still = second.samples.counts, ~moved(second.frame)
    total = round(0.25 * SIDE * SIDE)
    assert abs(int(counts[~still].sum()) - total / 2) <= 0.05 * total  # with disoccluded pixels
    blocks = torch.nn.functional.max_pool2d((counts * still).float(), 32)
    assert (blocks > 0).sum() <= 5  # one block, and those where pixels are disoccluded


def test_every_block_of_a_static_clip_has_its_turn():
    last = run_still(17, static=True)[-1].state
    least = -torch.nn.functional.max_pool2d(-last.spp, 32)
    assert least.min() >= 2  # of about four samples in one turn


def test_without_samples_image_and_state_stay():
    frames = run_still(2, static=True)
    frame, state = frames[-1].frame, frames[-1].state
    first = Still().denoise(frame.gbuffer, frame.pool.empty(), state)
    second = Still().denoise(frame.gbuffer, frame.pool.empty(), first[1])
    assert torch.equal(first[0], second[0])
    assert all(map(torch.equal, first[1], second[1]))
    assert all(map(torch.equal, first[1], state))


def test_a_still_scene_converges():
    """Towards the truth, because a pixel's own mean replaces the filtered image."""
    frames = run_still(40, spp=0.5, static=True)
    errors = [(r.image - r.frame.reference.mean).square().mean() for r in (frames[0], frames[-1])]
    assert errors[1] < errors[0] / 2


def test_old_light_weighs_at_most_64_samples():
    white, still, gbuffer = torch.ones(1, 3, 8, 8), Still(), wall(8, 8)
    surface = still.denoise(gbuffer, one_sample(white), still.start(Size(1, 8, 8)))[1].surface
    before = StillPixels(white, 1000 * white[:, :1], surface)
    _, state = still.denoise(gbuffer, one_sample(3 * white), before)
    torch.testing.assert_close(state.radiance, white * (MAX_SPP + 3) / (MAX_SPP + 1))
    assert torch.equal(state.spp, 1001 * white[:, :1])


@pytest.mark.parametrize("kind", ["surface", "background"])
def test_a_hole_is_filled_from_pixels_of_its_kind(kind):
    """Left half surface with light 2, right half background with light 5; a hole on each side."""
    left = (torch.arange(16) < 8).expand(1, 1, 16, 16)
    albedo = torch.where(left, 1.0, 0.0).expand(1, 3, 16, 16)
    depth = torch.where(left, 1.0, torch.inf)
    gbuffer = wall(16, 16, albedo=albedo, normal=albedo * 3**-0.5, depth=depth)
    counts = torch.ones(1, 1, 16, 16, dtype=torch.int64)
    counts[..., 5, 7] = counts[..., 5, 8] = 0
    light = torch.where(left, 2.0, 5.0).expand(1, 3, 16, 16)
    samples = Samples((light * (counts > 0))[:, None], counts)
    image, _ = Still().denoise(gbuffer, samples, Still().start(Size(1, 16, 16)))
    column, expected = (7, 2.0) if kind == "surface" else (8, 5.0)
    torch.testing.assert_close(image[0, :, 5, column], torch.full((3,), expected))


def test_frames_of_a_moving_camera_are_independent():
    clip = procedural_clip(3, Size(1, 64, 64), 2, 8)
    last = clip.frames[1]
    alone = next(iter(run_clip(Still(), replace(clip, frames=(last,)), 1.0)))
    after = list(run_clip(Still(), InMemoryClip("two", "procedural", "", clip.frames), 1.0))[1]
    share = (alone.image != after.image).float().mean()
    assert share < 0.2  # the sky has no normal, no albedo, no depth, and may not move
