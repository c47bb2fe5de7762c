"""Frames of which a mean is known: images are those of a run, states can be written and read."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest
import torch

import rlbench
from baselines.accumulate.memory import share_by_spp
from rlbench import registry
from rlbench.denoise import (
    CLIPPED,
    DEFAULT_METHOD,
    DenoiseError,
    check_denoises_means,
    denoise_frame,
)
from rlbench.frames import GBuffer, Size, StoredPool
from rlbench.ops.nested_tensors import is_bit_equal, read_leaves, replace_leaves
from rlbench.recorded_method import RecordedMethod
from tests.tapes import Tapes

FAMILIES = ("accumulate/tuned", "imcd", "nppd", "ntas", "oidn", "ours", "svgf", "eaw/still")


def noisy_frames(count: int = 3, spp: int = 4):
    """Frames of a procedural clip as means of samples without fireflies, and the clip."""
    generator, frames = torch.Generator().manual_seed(1), []
    for frame in rlbench.procedural_clip(seed=3, size=Size(1, 48, 64), frames=count):
        noise = 0.5 + torch.rand(1, 8, 3, 48, 64, generator=generator)
        pool = StoredPool(frame.reference.mean.unsqueeze(1) * noise, (frame.index,))
        frames.append(replace(frame, pool=pool))
    means = [rlbench.NoisyFrame(f.gbuffer, f.pool.radiance[:, :spp].mean(1), spp) for f in frames]
    return means, rlbench.InMemoryClip("noisy", "noisy", "none", frames)


@pytest.mark.parametrize("spp", [1, 4])
@pytest.mark.parametrize("name", ["mean", "oidn", "accumulate/tuned", "svgf"])
def test_one_image_is_the_first_frame_of_a_run(name, spp):
    frames, clip = noisy_frames(1, spp)
    image = next(rlbench.denoise(frames, name, exposure=1.0))
    expected = next(rlbench.run_clip(rlbench.load_method(name), clip, spp)).image
    if spp == 1:
        assert is_bit_equal(image, expected)
    torch.testing.assert_close(image, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", ["accumulate", "ntas/history", "svgf"])
def test_a_shot_by_a_uniform_method_is_that_of_a_run(name):
    frames, clip = noisy_frames(3, spp=1)
    images = rlbench.denoise(frames, name, exposure=1.0)
    results = rlbench.run_clip(rlbench.load_method(name), clip, 1)
    for image, result in zip(images, results, strict=True):
        assert is_bit_equal(image, result.image)


@pytest.mark.parametrize("name", ["oidn", "accumulate/tuned", "svgf"])
def test_recorded_frames_are_those_of_the_method(name):
    """As on a GPU: what the first frame of each kind did is replayed for those that follow."""
    method, recorder = rlbench.load_method(name), Tapes()
    frames, _ = noisy_frames(4)
    pairs = zip(
        rlbench.denoise(frames, RecordedMethod(method, recorder)),
        rlbench.denoise(frames, method),
        strict=True,
    )
    for image, expected in pairs:
        torch.testing.assert_close(image, expected, rtol=1e-4, atol=1e-4)
    assert sum(tape.replays for tape in recorder.tapes) >= 2


def test_radiance_keeps_its_scale():
    frames, _ = noisy_frames(2)
    bright = [rlbench.NoisyFrame(each.gbuffer, 100 * each.mean, each.spp) for each in frames]
    pairs = zip(rlbench.denoise(frames), rlbench.denoise(bright), strict=True)
    for image, brighter in pairs:
        torch.testing.assert_close(100 * image, brighter, rtol=0.02, atol=0.5)


def test_frames_are_read_when_they_are_needed():
    frames, _ = noisy_frames(3)
    read = []
    images = rlbench.denoise(read.append(each) or each for each in frames)
    next(images)
    assert len(read) == 1


def test_history_weighs_less_the_more_samples_a_frame_has():
    assert share_by_spp(1.0) == 1.0
    frames, _ = noisy_frames(2)
    method = rlbench.load_method("accumulate/tuned")
    shares = []
    for spp in (4, 8, 64, 512):
        state = denoise_frame(method, frames[0], None, 1.0).state
        after = rlbench.NoisyFrame(frames[1].gbuffer, frames[1].mean, spp)
        weight = denoise_frame(method, after, state, 1.0).state.radiance.accumulated_spp
        shares.append(1 - min(spp, 8) / weight.max().item())
    assert shares[1] > shares[2] > shares[3] > 0


@pytest.mark.parametrize("name", ["ours/paper", "restir"])
def test_a_method_that_needs_each_sample_is_refused(name):
    with pytest.raises(DenoiseError, match=DEFAULT_METHOD):
        check_denoises_means(name)


def test_rows_that_read_each_sample_say_so():
    rows = {name: registry.get_variant(name).traits for name in registry.expand(["ours/*"])}
    encodings = {name: rlbench.load_method(name).config.sample_encoding for name in rows}
    assert {name for name, traits in rows.items() if traits.reads_each_sample} == {
        name for name, encoding in encodings.items() if encoding == "single"
    }


def test_missing_motion_is_named_and_nothing_moves_is_accepted():
    frames, _ = noisy_frames(2)
    buffers = {k: v for k, v in frames[0].gbuffer.buffers.items() if k != "motion"}
    still = [rlbench.NoisyFrame(GBuffer(buffers), each.mean, each.spp) for each in frames]
    with pytest.raises(DenoiseError, match="motion"):
        list(rlbench.denoise(still))
    static = [rlbench.NoisyFrame(GBuffer(buffers, static=True), f.mean, f.spp) for f in still]
    assert len(list(rlbench.denoise(static))) == 2


@pytest.mark.parametrize("row", ["mean", "accumulate/tuned"])
@pytest.mark.parametrize("dark", [0.0, 1e-7])
def test_frames_after_a_dark_one_are_not_clipped(row, dark):
    image = torch.rand(1, 3, 9, 11, generator=torch.Generator().manual_seed(0))
    buffers = {"albedo": image, "normal": image * 0, "depth": image[:, :1] + 1}
    frames = [
        rlbench.NoisyFrame(GBuffer(buffers, static=True), image * light, 9)
        for light in (dark, 1.0, 1.0)
    ]
    *_, last = rlbench.denoise(frames, row)
    assert float(last.mean()) == pytest.approx(float(image.mean()), rel=0.05)


def test_invalid_pixels_are_replaced_and_counted_and_light_that_is_clipped_apart():
    image = torch.rand(1, 3, 4, 5)
    image[..., 0, 0], image[..., 1, 1] = 1e9, torch.nan
    frame = rlbench.NoisyFrame(GBuffer({}, static=True), image, 1)
    result = denoise_frame(rlbench.load_method("mean"), frame, None, 1.0)
    assert result.image.isfinite().all()
    assert result.repairs == {CLIPPED: 1, "radiance": 1}


@pytest.mark.parametrize("name", FAMILIES)
def test_a_state_is_that_of_its_leaves(name):
    frames, _ = noisy_frames(3)
    method = rlbench.load_method(name)
    other = denoise_frame(method, frames[2], None, 1.0).state
    state = denoise_frame(method, frames[0], None, 1.0).state
    state = denoise_frame(method, frames[1], state, 1.0).state
    restored = replace_leaves(other, dict(read_leaves(state)))
    for (path, one), (_, two) in zip(read_leaves(state), read_leaves(restored), strict=True):
        same = is_bit_equal(one, two) if isinstance(one, torch.Tensor) else one == two
        assert same, path
    images = [denoise_frame(method, frames[2], each, 1.0).image for each in (state, restored)]
    assert is_bit_equal(*images)


ALONE = [
    name
    for name in registry.expand(["all/*"])
    if not (variant := registry.get_variant(name)).traits.temporal
    and not variant.traits.reads_each_sample
    and variant.traits.pool == "path"
]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n not in ("oidn", "eaw"))) for n in ALONE]
)
def test_a_large_frame_is_denoised_in_tiles_without_a_seam(name, monkeypatch):
    """Tiles of 160 pixels, with what the network sees around them, against the whole frame."""
    frames, _ = noisy_frames(1)

    def enlarge(image):
        return torch.nn.functional.interpolate(image, (336, 352))

    buffers = {key: enlarge(buffer) for key, buffer in frames[0].gbuffer.buffers.items()}
    frame = rlbench.NoisyFrame(GBuffer(buffers, static=True), enlarge(frames[0].mean), 4)
    method = rlbench.load_method(name)
    whole = denoise_frame(method, frame, None, 1.0).image
    monkeypatch.setattr(sys.modules["rlbench.denoise"], "TILE", 160)
    difference = denoise_frame(method, frame, None, 1.0).image - whole
    # Open Image Denoise exposes a tile by its own light, here 2 to 3 % more or less
    assert float(difference.abs().amax() / whole.amax()) < 0.01
    steps = difference.diff(dim=-1).abs().mean((0, 1, 2))
    assert steps[[159, 319]].max() <= max(4 * float(steps.mean()), 1e-6)
