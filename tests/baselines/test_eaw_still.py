"""EAW on still pixels: what is kept, what begins anew, whose turn it is, and convergence."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from baselines.eaw.method import MAX_SPP, Still, StillPixels
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Samples, Size
from rlbench.run import FrameResult, run_clip

SIDE = 128  # 16 blocks, one of which has its turn in each frame


def run(frames: int, spp: float = 0.25, **options: bool) -> list[FrameResult]:
    clip = procedural_clip(3, Size(1, SIDE, SIDE), frames, 8, **options)
    return list(run_clip(Still(), clip, spp))


def moved(frame: Frame) -> Tensor:
    return frame.gbuffer.motion.abs().amax(1, keepdim=True) > 1e-3


def test_a_still_pixel_holds_the_mean_of_all_its_samples():
    frames = run(4, static=True)
    total = sum(result.samples.radiance.double().sum(1) for result in frames)
    counts = sum(result.samples.counts for result in frames)
    last = frames[-1].state
    assert torch.equal(last.spp, counts.float())
    expected = (total / counts.clamp_min(1)).float()
    torch.testing.assert_close(last.radiance, expected, rtol=1e-5, atol=1e-6)  # float32 sums


def test_a_pixel_that_moves_begins_anew_and_the_others_do_not():
    first, second = run(2, still_camera=True)
    anew = moved(second.frame)
    assert torch.equal(second.state.spp[anew], second.samples.counts[anew].float())
    counts = first.samples.counts + second.samples.counts
    disoccluded = (second.state.surface != first.state.surface).any(1, keepdim=True)
    kept = ~anew & ~disoccluded
    assert kept.float().mean() > 0.5
    assert torch.equal(second.state.spp[kept], counts[kept].float())


def test_half_of_the_budget_goes_to_what_moves_and_half_to_the_blocks_whose_turn_it_is():
    second = run(2, still_camera=True)[1]
    counts, still = second.samples.counts, ~moved(second.frame)
    total = round(0.25 * SIDE * SIDE)
    assert abs(int(counts[~still].sum()) - total / 2) <= 0.05 * total  # with disoccluded pixels
    blocks = torch.nn.functional.max_pool2d((counts * still).float(), 32)
    assert (blocks > 0).sum() <= 5  # one block, and those where pixels are disoccluded


def test_every_block_of_a_static_clip_has_its_turn():
    last = run(17, static=True)[-1].state
    least = -torch.nn.functional.max_pool2d(-last.spp, 32)
    assert least.min() >= 2  # of about four samples in one turn


def test_without_samples_image_and_state_stay():
    frames = run(2, static=True)
    frame, state = frames[-1].frame, frames[-1].state
    first = Still().denoise(frame.gbuffer, frame.pool.empty(), state)
    second = Still().denoise(frame.gbuffer, frame.pool.empty(), first[1])
    assert torch.equal(first[0], second[0])
    assert all(map(torch.equal, first[1], second[1]))
    assert all(map(torch.equal, first[1], state))


def test_a_still_scene_converges():
    """Towards the truth, because a pixel's own mean replaces the filtered image."""
    frames = run(40, spp=0.5, static=True)
    errors = [(r.image - r.frame.reference.mean).square().mean() for r in (frames[0], frames[-1])]
    assert errors[1] < errors[0] / 2


def test_old_light_weighs_at_most_64_samples():
    white = torch.ones(1, 3, 8, 8)
    gbuffer = GBuffer(
        {"albedo": white, "normal": white * 3**-0.5, "depth": white[:, :1]}, static=True
    )
    samples = Samples(3 * white[:, None], torch.ones(1, 1, 8, 8, dtype=torch.int64))
    start = Still().start(Size(1, 8, 8))
    surface = Still().denoise(gbuffer, samples, start)[1].surface
    _, state = Still().denoise(gbuffer, samples, StillPixels(white, 1000 * white[:, :1], surface))
    torch.testing.assert_close(state.radiance, white * (MAX_SPP + 3) / (MAX_SPP + 1))
    assert torch.equal(state.spp, 1001 * white[:, :1])


@pytest.mark.parametrize("kind", ["surface", "background"])
def test_a_hole_is_filled_from_pixels_of_its_kind(kind):
    """Left half surface with light 2, right half background with light 5; a hole on each side."""
    left = (torch.arange(16) < 8).expand(1, 1, 16, 16)
    albedo = torch.where(left, 1.0, 0.0).expand(1, 3, 16, 16)
    depth = torch.where(left, 1.0, torch.inf)
    gbuffer = GBuffer({"albedo": albedo, "normal": albedo * 3**-0.5, "depth": depth}, static=True)
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
