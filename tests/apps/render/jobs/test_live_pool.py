"""The live pool, and the cost of scattered samples."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
import torch

import rlbench
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.live_pool import (
    LiveClip,
    LivePool,
    open_live_clip,
    open_wavefronts,
    scatter_factor,
)
from rlbench.apps.render.jobs.render_clips import render_clip, scene_of_clip
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.benchmark.clip_sources import StoredSource, open_source
from rlbench.benchmark.cost import FULL_FRAME
from rlbench.benchmark.run_plan import CellLoader, RunPlan, list_cells
from rlbench.benchmark.timing import ScatterMeter
from rlbench.clips.exr import channel_dtype
from rlbench.clips.header import ClipError
from rlbench.clips.presets import Preset
from rlbench.clips.stored import open_clip
from rlbench.family import Traits
from rlbench.run import run_clip
from rlbench.sampling import draw_samples
from tests.apps.render.conftest import install_scene, launches, own_cache
from tests.apps.render.small_scenes import grey, room
from tests.conftest import write_noise

H, W = 16, 24
PRESET = Preset("test", "tests", (H, W), frames=3, reference_spp=2, pool_spp=4)


@dataclass(frozen=True)
class Follows:
    """Samples bright pixels in two passes, with the previous image as state."""

    traits: Traits = Traits(adaptive=True, temporal=True, passes=(0.3, 1.0))

    def start(self, size):
        return torch.zeros(1, 1, size.h, size.w)

    def plan(self, gbuffer, samples, state):
        return samples.mean.mean(1, keepdim=True) + state + 0.01

    def denoise(self, gbuffer, samples, state):
        return samples.mean, samples.mean.mean(1, keepdim=True)


def glaring():
    """The room with a lamp so bright that half precision cannot hold its reflections."""
    *others, lamp = room().meshes
    emission = {"type": "area", "radiance": grey(1e7)}
    return replace(room(), meshes=(*others, replace(lamp, emission=emission)))


@pytest.fixture(scope="module")
def rendered_room(usable_llvm, tmp_path_factory):
    with own_cache(tmp_path_factory):
        folder = tmp_path_factory.mktemp("live") / "room"
        render_clip(Job("room", room(), PRESET, folder))
        return folder


def open_both(folder, scene, seed=0, **more):
    """The clip with its stored pool, and with a live one."""
    stored = open_clip(folder, seed=seed)
    return stored, LiveClip(stored, open_tracer(scene, H, W, **more))


def agree(image, other):
    """Equal but for a few pixels in 10^4, where Embree decides: see WavefrontTracer."""
    return float((image != other).any(1).double().mean()) < 0.01


def images(clip, spp):
    return torch.cat([result.image for result in run_clip(Follows(), clip, spp)])


@pytest.mark.parametrize("spp", [0.0, 0.01, 0.5, 2.3, 4.0])
def test_a_method_makes_the_same_images_of_live_and_of_stored_samples(llvm, rendered_room, spp):
    stored, live = open_both(rendered_room, room(), seed=5)
    assert torch.equal(images(live, spp), images(stored, spp))


@pytest.mark.parametrize("case", ["scalar", "capped", "stored as float"])
def test_special_samples_are_the_same_live(request, tmp_path, case):
    select_variant("scalar_rgb") if case == "scalar" else request.getfixturevalue("llvm")
    scene = glaring() if case == "stored as float" else room()
    cap = 0.25 if case == "capped" else np.inf
    render_clip(Job("room", scene, PRESET.with_radiance_cap(cap), tmp_path))
    stored, live = open_both(tmp_path, scene, radiance_cap=cap / scene.exposure)
    dtype = channel_dtype(tmp_path / "pool.path.0000.exr", "s0.R")
    assert (dtype == np.float32) == (case == "stored as float")
    assert torch.equal(images(live, 1.7), images(stored, 1.7))


def test_a_frame_kept_by_the_caller_still_returns_its_own_samples(llvm, rendered_room):
    stored, live = open_both(rendered_room, room())
    first, expected = (
        draw_samples(pool, pool.empty(), torch.ones(1, 1, H, W), 1.5).radiance
        for pool in (list(live)[1].pool, stored.frame(1).pool)
    )
    assert torch.equal(first, expected)


def test_each_sample_drawn_is_one_path_and_nothing_else_is_traced(llvm, rendered_room):
    _, live = open_both(rendered_room, room())
    pool = live.frame(1).pool
    density = torch.rand(1, 1, H, W, generator=torch.Generator().manual_seed(0))
    samples, sizes = pool.empty(), []
    for upto in (0.01, 0.1, 0.9, 4.0):
        kernels, samples = launches(
            lambda upto=upto, samples=samples: draw_samples(pool, samples, density, upto)
        )
        sizes += [kernel["size"] for kernel in kernels]
    # 0.01, 0.1, 0.9 and 4 times 16 x 24, less the samples drawn before
    assert sizes == [4, 38 - 4, 346 - 38, 1536 - 346]


def maps():
    """Random counts of 0 to 8 samples per pixel: in total one, none, two, 0.01 spp, and more."""
    random = np.random.default_rng(0)
    for drawn in (1, 0, 2, round(0.01 * H * W), H * W // 3, 3 * H * W):
        counts = np.bincount(random.integers(0, H * W, drawn), minlength=H * W)
        yield torch.from_numpy(np.minimum(counts, 8)).view(1, 1, H, W)


@pytest.mark.parametrize(
    "name",
    ["", *(pytest.param(n, marks=pytest.mark.slow) for n in ("temple", "city", "hall", "ripples"))],
)
def test_no_map_of_counts_compiles_a_kernel_and_each_costs_its_sum(llvm, name):
    tracer = open_tracer(scene_of_clip(name) if name else room(), H, W)

    def pool(time):
        tracer.set_time(time)
        return LivePool(tracer, time, tuple(range(8)), 1, 1.0, torch.float16, torch.device("cpu"))

    first = pool(0.0)
    first.read(first.empty(), torch.ones(1, 1, H, W, dtype=torch.int64))
    for time in (1.0, 2.0):
        later = pool(time)
        for counts in maps():
            kernels, _ = launches(partial(later.read, later.empty(), counts))
            assert all(kernel["cache_hit"] for kernel in kernels)
            drawn = int(counts.sum())
            # one wavefront as wide as the samples drawn; a single lane would be another kernel
            assert [k["size"] for k in kernels] == [max(drawn, 2)] * (drawn > 0)


@pytest.fixture
def folder(llvm, rendered_room, tmp_path, monkeypatch):
    """A clip of the installed scene `room`."""
    install_scene(monkeypatch, "room", room)
    return shutil.copytree(rendered_room, tmp_path / "room")


def test_the_benchmark_opens_live_and_stored_clips_under_different_content_keys(folder):
    live, stored = open_source(folder, "live"), open_source(folder, "stored")
    device = torch.device("cpu")
    clips = [source.open(Follows().traits, 1.0, 3, device) for source in (live, stored)]
    assert isinstance(clips[0], LiveClip)
    assert agree(images(clips[0], 1.0), images(clips[1], 1.0))
    assert live.content("path") != stored.content("path") == StoredSource(folder).content("path")


def test_a_live_pool_holds_more_samples_than_are_stored_and_the_stored_ones_come_first(folder):
    stored = open_clip(folder, seed=3)  # 4 samples per pixel
    pools = [clip.frame(1).pool for clip in (stored, open_live_clip(stored, 16))]
    few, many = (
        pool.read(pool.empty(), torch.full((1, 1, H, W), count))
        for pool, count in zip(pools, (4, 16), strict=True)
    )
    assert agree(many[0, :4], few[0])
    assert len({image.numpy().tobytes() for image in many[0]}) == 16


def test_more_samples_than_are_stored_are_measured_live(folder, tmp_path):
    folders = {"clips": [folder], "pool": "live", "out": tmp_path / "r", "times": "none"}
    rows = rlbench.run(["mean"], spp=[4, 16], **folders)
    mean = rows[rows["metric"] == "psnr"].groupby("target_spp")[["value", "mean_spp"]].mean()
    assert mean["mean_spp"].to_dict() == {4.0: 4.0, 16.0: 16.0}
    assert mean["value"][16.0] > mean["value"][4.0]


def test_a_live_pool_leaves_room_for_a_density_that_varies(folder):
    clip = open_source(folder, "live").open(Follows().traits, 6.0, 0, torch.device("cpu"))
    counts = next(run_clip(Follows(), clip, 6.0)).samples.counts
    assert int(counts.sum()) == 6 * H * W
    assert int(counts.max()) > 6


def test_a_scene_that_has_changed_is_an_error(folder):
    mark = folder / "scene.txt"
    mark.write_text(mark.read_text().replace(mark.read_text()[:16], "0123456789abcdef"))
    with pytest.raises(ClipError, match="the clip has 0123456789abcdef.*--pool stored"):
        open_source(folder, "live")


def test_a_clip_of_another_renderer_is_an_error(tmp_path):
    with pytest.raises(ClipError, match="did not write it. Use --pool stored"):
        open_source(write_noise(tmp_path / "noise"), "live")


def test_only_the_path_pool_can_be_live(tmp_path):
    clip = open_clip(write_noise(tmp_path / "noise", pools=("path",)))
    with pytest.raises(ClipError, match="pool 'restir' cannot be sampled live"):
        open_live_clip(replace(clip, pool="restir"))


def test_a_scene_that_is_not_installed_is_an_error(rendered_room):
    with pytest.raises(LookupError, match="'room' is not a scene"):
        open_source(rendered_room, "live")


class CountingTracer:
    """A tracer whose sample of a full frame costs 1, and any other sample 1.25."""

    height, width = 2, 3

    def __init__(self):
        self.traced = []

    def trace_tensors(self, pixels, samples, stream):
        self.traced = list(zip(pixels.tolist(), samples.tolist(), strict=True))

    def relative_cost(self, work, spp):
        work()
        return 1.25 * len(self.traced) / (spp * self.height * self.width)


def test_the_factor_is_per_sample_and_of_the_methods_own_counts():
    tracer = CountingTracer()
    counts = torch.tensor([[2, 0, 1], [0, 0, 1]]).view(1, 1, 2, 3)
    assert scatter_factor(tracer, counts) == pytest.approx(1.25)
    assert tracer.traced == [(0, 0), (0, 1), (2, 0), (5, 0)]


def scatter_meter(folder):
    """The meter of a clip's plan, and the plan's only cell, of an adaptive method."""
    plan = RunPlan(("ours/by-rule",), (StoredSource(folder),), (2.0,))
    (only,) = list_cells(plan)
    return ScatterMeter(CellLoader(plan)), only


def test_a_real_scene_has_a_factor_near_one(folder):
    """384 pixels: fixed costs of a launch and other load leave no more than the order."""
    meter, adaptive = scatter_meter(folder)
    assert meter.has_scene(adaptive)
    measured = meter.measure(adaptive)
    assert measured.note == ""
    assert 0.1 < measured.factor < 10
    counts = torch.from_numpy(np.full((1, 1, 16, 24), 1))
    assert 0.2 < scatter_factor(open_wavefronts(folder), counts) < 5


def test_a_clip_without_its_scene_charges_samples_of_a_full_frame_and_says_why(tmp_path):
    meter, adaptive = scatter_meter(write_noise(tmp_path / "noise"))
    assert not meter.has_scene(adaptive)
    measured = meter.measure(adaptive)
    assert measured.factor == FULL_FRAME.factor == 1.0
    assert measured.note.startswith("scattered samples cost as those of a full frame: ")
    assert "`rlbench render` did not write it" in measured.note
