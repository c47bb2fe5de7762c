"""Skipped tiles: images and states stay bit-identical, and fewer pixels are denoised."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import RunSummary
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.errors import PluginError
from rlbench.frames import Size
from rlbench.method import Method
from rlbench.ops.nested_tensors import is_bit_equal, iterate_tensors
from rlbench.run import FrameResult, run_clip
from rlbench.wrappers import MethodWrapper, SkipTiles
from tests.measuring import measure_scores

CPU = torch.device("cpu")
SIZE = Size(1, 200, 330)  # larger than a chunk of `rlbench.ops.padded_rows`, and no whole tiles
LOCAL = [
    name
    for name in registry.expand(["all/*"], pretrained_only=False)
    if registry.get_variant(name).traits.receptive_field is not None
]
CLIPS = {"static": {"static": True}, "still camera": {"still_camera": True}, "moving": {}}


@dataclass(frozen=True)
class CountPixels(MethodWrapper[Method]):
    """The wrapped method, and the number of pixels that it denoised in each call."""

    pixels: list[int] = field(default_factory=list)

    def denoise(self, gbuffer, samples, state):
        self.pixels.append(samples.counts.numel())
        return super().denoise(gbuffer, samples, state)


def make_clip(frames: int = 5, size: Size = SIZE, seed: int = 3, **options) -> InMemoryClip:
    clip = procedural_clip(seed, size, frames, 8, **options)
    return replace(clip, frames=tuple(clip.frames))  # computed once


def load(name: str) -> Method:
    return registry.load_method(name, CPU)


def run(method: Method, clip: InMemoryClip, spp: float = 0.25) -> list[FrameResult]:
    return list(run_clip(method, clip, spp))


@pytest.mark.parametrize("kind", CLIPS)
@pytest.mark.parametrize("name", LOCAL)
def test_images_and_states_are_those_of_the_method_bit_by_bit(name, kind):
    clip = make_clip(**CLIPS[kind])
    plain, skipping = run(load(name), clip), run(SkipTiles(load(name)), clip)
    for one, other in zip(plain, skipping, strict=True):
        assert torch.equal(one.samples.counts, other.samples.counts)
        assert is_bit_equal(one.image, other.image)
        states = iterate_tensors(one.state), iterate_tensors(other.state.state)
        assert all(is_bit_equal(*pair) for pair in zip(*states, strict=True))


@pytest.mark.parametrize(("kind", "least"), [("static", 0.5), ("still camera", 0.1)])
def test_most_pixels_of_a_still_scene_are_not_denoised_again(kind, least):
    method = CountPixels(load("eaw/still"))
    last = run(SkipTiles(method), make_clip(**CLIPS[kind]))[2:]
    assert min(result.state.skipped for result in last) > least
    assert sum(method.pixels) < (5 - 3 * least / 2) * SIZE.h * SIZE.w  # with those in reach


@pytest.mark.parametrize(("name", "kind"), [("eaw/still", "moving"), ("mean", "static")])
def test_a_moving_camera_and_uniform_samples_leave_no_tile_to_skip(name, kind):
    """Dither spreads a quarter of a sample per pixel over every 2 x 2 pixels."""
    method = CountPixels(load(name))
    results = run(SkipTiles(method), make_clip(**CLIPS[kind]))
    assert [result.state.skipped for result in results] == [0.0] * 5
    assert method.pixels == [SIZE.h * SIZE.w] * 5


@dataclass(frozen=True)
class SampleCorner(MethodWrapper[Method]):
    """The wrapped method, with all samples in one corner, another one in each frame."""

    corners: list[int] = field(default_factory=list)

    @property
    def traits(self):
        return replace(super().traits, adaptive=True)

    def plan(self, gbuffer, samples, state):
        self.corners.append(len(self.corners) % 4)
        density = torch.zeros_like(samples.counts, dtype=torch.float32)
        down, right = divmod(self.corners[-1], 2)
        density[..., 60 * down : 60 * down + 40, 90 * right : 90 * right + 70] = 1
        return density


@pytest.mark.parametrize("name", LOCAL)
def test_windows_anywhere_hold_the_pixels_of_the_image(name):
    """At borders too; a torch sum of eight samples may round the last pixels in another way."""
    clip = make_clip(8, Size(1, 100, 160), static=True)
    plain = run(SampleCorner(load(name)), clip)
    skipping = run(SkipTiles(SampleCorner(load(name))), clip)
    assert sum(result.state.skipped > 0 for result in skipping) >= 3
    for one, other in zip(plain, skipping, strict=True):
        if name == "eaw/still":
            assert is_bit_equal(one.image, other.image)
        torch.testing.assert_close(one.image, other.image, rtol=1e-6, atol=0)


def test_a_changed_pixel_is_denoised_again_with_all_pixels_in_reach():
    """A pixel of the state changes between two frames without samples."""
    clip, method = make_clip(3, static=True), load("eaw/still")
    counter = CountPixels(method)
    skipping, gbuffer = SkipTiles(counter), clip.frames[0].gbuffer
    state = run(SkipTiles(method), clip, 0.25)[-1].state
    empty = clip.frames[0].pool.empty()
    for _ in range(2):  # the first frame without samples still follows one with samples
        image, state = skipping.denoise(gbuffer, empty, state)
    counter.pixels.clear()
    state.state.radiance[0, :, 100, 40] = 5
    state.state.spp[0, :, 100, 40] = 5
    changed, after = skipping.denoise(gbuffer, empty, state)
    assert counter.pixels == [(64 + 2 * 17) * (64 + 17)]  # rows 64 to 128, columns 0 to 64
    assert torch.equal(changed, method.denoise(gbuffer, empty, state.state)[0])
    assert not torch.equal(changed, image)
    assert 0 < after.skipped < 1


def test_a_batch_skips_only_what_is_unchanged_in_all_of_its_clips():
    clip = make_clip(3, Size(2, 96, 160), static=True)
    plain, skipping = run(load("eaw/still"), clip), run(SkipTiles(load("eaw/still")), clip)
    assert all(is_bit_equal(a.image, b.image) for a, b in zip(plain, skipping, strict=True))


@dataclass(frozen=True)
class Remembers(MethodWrapper[Method]):
    """A local method with any state."""

    state: object

    def start(self, size):
        return self.state

    def denoise(self, gbuffer, samples, state):
        return samples.mean, state


class TwoParts(NamedTuple):
    first: Tensor
    second: Tensor


@pytest.mark.parametrize(
    "state",
    [7, torch.zeros(1, 1, 64, 64), TwoParts(torch.zeros(1, 1, 64, 64), torch.zeros(3))],
    ids=["a number", "a tensor", "a tuple with a vector"],
)
def test_a_state_that_cannot_be_cut_into_tiles_is_an_error(state):
    clip = make_clip(3, Size(1, 64, 64), static=True)
    with pytest.raises(PluginError, match="return None or a named tuple of tensors"):
        run(SkipTiles(Remembers(load("mean"), state)), clip)


def test_a_method_without_a_receptive_field_is_an_error():
    with pytest.raises(PluginError, match="declare Traits"):
        SkipTiles(load("eaw"))


def test_rows_of_skipped_tiles_have_equal_scores_and_the_share(clip_folder, tmp_path):
    """A method without a receptive field keeps its row."""
    name = "eaw/still"
    plan = RunPlan((name, "eaw"), (StoredSource(clip_folder),), (1.0,), skip_tiles=True)
    measure_scores(replace(plan, skip_tiles=False), tmp_path / "r")
    assert measure_scores(plan, tmp_path / "r") == RunSummary(measured=1, cached=1)
    rows = results.read(tmp_path / "r").set_index(["method", "frame", "metric"])["value"]
    assert rows[name, 2, "psnr"] == rows[f"{name}@tiles", 2, "psnr"]
    assert 0 <= rows[f"{name}@tiles", 2, "tiles_skipped"] <= 1
    assert (name, 2, "tiles_skipped") not in rows.index
