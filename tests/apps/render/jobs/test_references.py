"""References: noise ceiling and rounds."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from metrics.catalog import PSNR
from rlbench.apps.render.jobs import references
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.render_clips import render_clip
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.clips.header import read_header
from rlbench.clips.presets import Preset
from rlbench.clips.stored import open_clip
from tests.apps.render.small_scenes import looking_down, room

H, W = 16, 24
PRESET = Preset("test", "tests", (H, W), frames=2, reference_spp=4, pool_spp=1)


def noisy(sigma, seed, h=100, w=100):
    random = np.random.default_rng(seed)
    truth = np.linspace(0.05, 0.8, h * w * 3).reshape(h, w, 3)
    halves = [(truth * (1 + sigma * random.normal(size=truth.shape))) for _ in "AB"]
    return truth.astype(np.float32), *(half.astype(np.float32) for half in halves)


@pytest.mark.parametrize("sigma", [0.001, 0.01, 0.05])
def test_the_noise_ceiling_is_the_psnr_of_the_noise_free_image(sigma):
    truth, a, b = noisy(sigma, seed=1)
    images = [torch.from_numpy(i).permute(2, 0, 1)[None] for i in (truth, (a + b) / 2)]
    frame = PSNR.compare(images[0], images[1], images[1])
    # the deviation of a mean of 30000 squares, which is below 0.05 dB, and the curve's bend
    assert references.noise_ceiling_db(a, b, 1.0) == pytest.approx(
        float(PSNR.score(frame)), abs=0.1
    )


def test_the_noise_ceiling_takes_exposure_and_clipping_into_account():
    _, a, b = noisy(0.05, seed=2)
    # all is white, and the display shows no noise
    assert references.noise_ceiling_db(a, b, 1000.0) == references.noise_ceiling_db(a, a, 1) == 100


@pytest.mark.parametrize(("spp", "rounds"), [(1, 1), (5, 1), (4, 3)])
def test_a_reference_is_the_mean_of_each_stream_however_many_rounds_it_has(llvm, spp, rounds):
    tracer = open_tracer(room(), H, W)
    preset = replace(PRESET, reference_spp=spp, max_reference_rounds=rounds)
    *halves, total_spp = references.trace_reference(tracer, preset, 1.0)
    assert total_spp == 2 * rounds * spp
    for half, stream in zip(halves, ("referenceA", "referenceB"), strict=True):
        # a float64 sum in another order, rounded to float32
        np.testing.assert_allclose(half, tracer.trace_mean(rounds * spp, stream), rtol=1e-6)


def test_rounds_end_once_the_ceiling_is_high_enough(llvm):
    tracer = open_tracer(room(), H, W)
    preset = replace(PRESET, max_reference_rounds=50, min_noise_ceiling_db=25.0)
    a, b, total_spp = references.trace_reference(tracer, preset, room().exposure)
    assert 8 < total_spp < 400
    assert references.noise_ceiling_db(a, b, room().exposure) >= 25.0
    fewer = replace(preset, max_reference_rounds=total_spp // 8 - 1, min_noise_ceiling_db=math.inf)
    before = references.trace_reference(tracer, fewer, room().exposure)
    assert references.noise_ceiling_db(*before[:2], room().exposure) < 25.0


def test_nothing_is_traced_once_the_reference_is_good_enough_and_progress_counts_it(
    llvm, monkeypatch
):
    tracer, traced, samples = open_tracer(room(), H, W), [], []
    trace = tracer.trace_sum
    monkeypatch.setattr(
        tracer, "trace_sum", lambda spp, *rest, **on: traced.append(spp) or trace(spp, *rest, **on)
    )
    preset = replace(PRESET, max_reference_rounds=50, min_noise_ceiling_db=25.0)
    *_, total_spp = references.trace_reference(tracer, preset, room().exposure, samples.append)
    assert sum(traced) == total_spp < 2 * 50 * 4 == sum(samples)


def test_an_easy_scene_needs_fewer_samples_and_the_header_records_them(llvm, tmp_path):
    """A plane under an even sky: no path is much brighter than another."""
    easy = looking_down({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}})
    preset = replace(PRESET, max_reference_rounds=6, min_noise_ceiling_db=30.0)
    headers = []
    for name, scene in (("easy", easy), ("hard", room())):
        render_clip(Job(name, scene, preset, tmp_path / name))
        headers.append(read_header(tmp_path / name))
    assert max(headers[0].reference_spp) < min(headers[1].reference_spp)
    assert min(headers[0].noise_ceiling_db) >= 30.0
    reference = open_clip(tmp_path / "hard").frame(1).reference
    halves = (half[0].movedim(0, -1).numpy() for half in (reference.half_a, reference.half_b))
    ceiling = references.noise_ceiling_db(*halves, 1.0)
    assert headers[1].noise_ceiling_db[1] == pytest.approx(ceiling)


def test_a_resumed_clip_keeps_sample_counts_and_traces_a_frame_whose_count_is_lost(llvm, tmp_path):
    preset = replace(PRESET, max_reference_rounds=4, min_noise_ceiling_db=24.0)
    job = Job("room", room(), preset, tmp_path)
    render_clip(job)
    total_spp = read_header(tmp_path).reference_spp
    (tmp_path / "clip.toml").unlink()
    (tmp_path / "referenceB.0001.exr").unlink()
    assert job.missing_frames == [1]
    render_clip(job)
    assert read_header(tmp_path).reference_spp == total_spp
    (tmp_path / "rounds.0000.txt").unlink()
    assert job.missing_frames == [0]
    assert not job.is_finished
