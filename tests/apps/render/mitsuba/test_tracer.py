"""Tracers: independent samples, their means and costs, and their random numbers."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from rlbench.apps.render.jobs.render_clips import scene_of_clip
from rlbench.apps.render.mitsuba import load
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.tracer import STREAMS, make_sampler, stream_key
from rlbench.apps.render.mitsuba.variant import select_variant
from tests.apps.render.conftest import check_no_kernel_is_compiled
from tests.apps.render.small_scenes import atlas, diffuse, looking_down, room, under_a_lamp

H, W = 24, 32


@pytest.fixture
def tracer(llvm):
    return open_tracer(room(), H, W)


@pytest.mark.parametrize("count", [0, 1, 7, 1000])
def test_any_pairs_in_any_order_equal_the_stack(tracer, count):
    random = np.random.default_rng(count)
    pixels, samples = random.integers(0, H * W, count), random.integers(0, 4, count)
    stack = tracer.trace_images(4).reshape(4, -1, 3)
    np.testing.assert_array_equal(tracer.trace(pixels, samples), stack[samples, pixels])
    pairs = torch.from_numpy(pixels), torch.from_numpy(samples)
    np.testing.assert_array_equal(tracer.trace_tensors(*pairs).numpy(), stack[samples, pixels])


@pytest.mark.parametrize("launches", [1, 3])
def test_what_is_timed_is_every_sample_of_a_frame(tracer, launches, monkeypatch):
    """A GPU computes it in its own memory, without the copy to images on the host."""
    monkeypatch.setattr("rlbench.apps.render.mitsuba.tracer.MAX_PATHS", 3 * H * W // launches)
    stack = tracer.trace_images(3, "pilot").reshape(3, -1, 3)
    timed = tracer.trace_frame(3)
    assert len(timed) == launches
    joined = torch.cat([each.reshape(H * W, -1, 3) for each in timed], 1)
    np.testing.assert_array_equal(joined.numpy(), stack.swapaxes(0, 1))


def test_samples_depend_neither_on_earlier_times_nor_on_the_length_of_the_stack(variant):
    tracer = open_tracer(room(), H, W)
    tracer.set_time(1.0)
    before = tracer.trace_images(1)
    tracer.set_time(5.0)
    tracer.set_time(1.0)
    np.testing.assert_array_equal(tracer.trace_images(2)[:1], before)


def test_a_result_does_not_change_with_the_next_launch(tracer):
    pixels, samples = np.arange(64), np.zeros(64, int)
    radiance = tracer.trace(pixels, samples)
    before = radiance.copy()
    radiance[0] = before[0] = -1  # a caller may write into it
    tracer.trace(pixels, samples + 1)
    np.testing.assert_array_equal(radiance, before)


def test_the_mean_is_that_of_the_stack_whatever_the_chunk(tracer):
    stack = tracer.trace_images(6, "referenceA").mean(0, dtype=np.float64)
    # float32 result of a float64 sum
    np.testing.assert_allclose(tracer.trace_mean(6, "referenceA", chunk=4), stack, rtol=1e-6)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_do_not_change_a_sample(tracer, threads):
    import drjit as dr

    tracer.set_time(2.0)
    before, usual = tracer.trace_images(2), dr.thread_count()
    dr.set_thread_count(threads)
    try:
        tracer.set_time(2.0)
        np.testing.assert_array_equal(tracer.trace_images(2), before)
    finally:
        dr.set_thread_count(usual)


@pytest.mark.parametrize("other", ["referenceA", "referenceB", "pilot"])
def test_streams_are_independent(variant, other):
    tracer = open_tracer(room(), H, W)
    first, second = tracer.trace_images(32), tracer.trace_images(32, other)
    noise = [(s - (first.mean(0) + second.mean(0)) / 2)[:, H // 2 :, :, 0] for s in (first, second)]
    product = (np.clip(noise[0], -1, 1) * np.clip(noise[1], -1, 1)).reshape(32, -1)
    # the common mean leaves -1/64 of the variance; 4 standard errors
    assert abs(product.mean()) < 4 * product.std() / np.sqrt(product.size) + 2e-3


def test_a_diffuse_plane_under_a_constant_sky_shines_by_its_albedo(variant):
    tracer = open_tracer(looking_down(diffuse(0.5, 0.25, 0.75), sky=2.0), 16, 16)
    samples = tracer.trace_images(64).reshape(-1, 3).astype(np.float64)
    error = 4 * samples.std(0) / np.sqrt(len(samples)) + 1e-6
    assert (abs(samples.mean(0) - [1.0, 0.5, 1.5]) < error).all()


@pytest.mark.parametrize("has_atlas", [False, True])
def test_a_floor_below_lamps_has_the_radiance_of_the_form_factor(variant, has_atlas):
    scene, radiance = under_a_lamp(half=0.5, height=2.0, radiance=10.0, albedo=0.6)
    if has_atlas:  # four lamps in place of one, 10 in the mean
        texels = np.array([[[4.0] * 3, [16.0] * 3], [[12.0] * 3, [8.0] * 3]])
        scene = replace(scene, meshes=(scene.meshes[0], atlas(0.5, 2.0, texels)))
    samples = open_tracer(scene, 16, 16).trace_images(64).ravel().astype(np.float64)
    # 4 standard errors, and 1e-3 for the patch of floor; four squares count alike there
    error = 4 * samples.std() / np.sqrt(len(samples)) + 1e-3 * radiance
    assert abs(samples.mean() - radiance) < error


def test_both_kinds_of_tracer_see_the_same_picture(llvm):
    first = open_tracer(room(), H, W).trace_images(256)
    select_variant("scalar_rgb")
    second = open_tracer(room(), H, W).trace_images(256)
    blocks = [s.reshape(256, 3, 8, 4, 8, 3).mean((2, 4)) for s in (first, second)]
    error = np.sqrt(sum(b.var(0) for b in blocks) / 256) + 1e-4
    score = (blocks[0].mean(0) - blocks[1].mean(0)) / error
    assert abs(score).max() < 5  # 36 scores


def test_a_cap_dims_what_is_brighter_in_its_own_colour(variant):
    free, capped = (open_tracer(room(), H, W, radiance_cap=cap) for cap in (np.inf, 0.3))
    radiance, dimmed = free.trace_images(4), capped.trace_images(4)
    brightest = radiance.max(-1, keepdims=True)
    over = brightest > 0.3
    assert 0.01 < over.mean() < 0.99
    np.testing.assert_array_equal(dimmed[~over[..., 0]], radiance[~over[..., 0]])
    # one division and one multiplication in float32
    np.testing.assert_allclose(dimmed, radiance * (0.3 / np.maximum(brightest, 0.3)), rtol=1e-6)
    expected = dimmed.mean(0, dtype=np.float64)
    np.testing.assert_allclose(capped.trace_mean(4, "input"), expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["city", "hall"])
def test_hardly_a_sample_of_a_real_scene_depends_on_the_wavefront(llvm, name):
    tracer = open_tracer(scene_of_clip(name), 96, 96)
    stack = tracer.trace_images(8).reshape(8, -1, 3)
    pixels = np.arange(96 * 96)
    samples = np.random.default_rng(0).integers(0, 8, len(pixels))
    other = (tracer.trace(pixels, samples) != stack[samples, pixels]).any(1)
    # where a camera ray meets two triangles at once, see WavefrontTracer; measured: 0 to 4 in 10^4
    assert other.mean() < 1e-3


def test_no_kernel_is_compiled_after_the_first_frame(tracer):
    def work(time):
        tracer.set_time(time)
        render_gbuffer(tracer)
        tracer.trace_images(2)
        random = np.random.default_rng(int(time))
        count = int(random.integers(1, 200))
        tracer.trace(random.integers(0, H * W, count), random.integers(0, 99, count), "pilot")

    work(0.0)
    tracer.seed, tracer.radiance_cap = 12, 0.5  # of another clip
    check_no_kernel_is_compiled(lambda: [work(time) for time in (1.0, 2.0, 3.5)])


def numbers(pixels, samples, key, count):
    import drjit as dr
    import mitsuba as mi

    arrays = [load.upload(mi.UInt32, np.asarray(a)) for a in (pixels, samples)]
    source = make_sampler(*arrays, [dr.opaque(mi.UInt32, k) for k in key])
    return np.stack([np.array(source.next_1d()) for _ in range(count)], axis=1)


def test_streams_times_and_seeds_never_share_a_key():
    choices = itertools.product(STREAMS, (-1.0, 0.0, 0.5, 1.0), (0, 1))
    keys = [stream_key(*choice) for choice in choices]
    assert len(set(keys)) == len(keys)


def test_numbers_are_uniform(llvm):
    pixel, sample = np.indices((100, 100)).reshape(2, -1)
    drawn = numbers(pixel, sample, stream_key("input", 0.0, 0), 4)
    counts = np.histogram(drawn, 50, (0, 1))[0]
    expected = drawn.size / 50
    assert ((counts - expected) ** 2 / expected).sum() < 49 + 4 * np.sqrt(2 * 49)  # chi2 + 4 sd


@pytest.mark.parametrize("moved", ["pixel", "sample", "dimension"])
def test_neighbours_are_uncorrelated(llvm, moved):
    pixel, sample = np.indices((100, 100)).reshape(2, -1)
    drawn = numbers(pixel, sample, stream_key("input", 0.0, 0), 2).reshape(100, 100, 2)
    first, second = {
        "pixel": (drawn[1:], drawn[:-1]),
        "sample": (drawn[:, 1:], drawn[:, :-1]),
        "dimension": (drawn[..., 0], drawn[..., 1]),
    }[moved]
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 4 / np.sqrt(first.size)


@pytest.mark.parametrize("other", [(2**20, 0), (0, 4096), (1, 0), (2**31, 0), (0, 2**31)])
def test_pixels_and_samples_of_any_size_have_numbers_of_their_own(llvm, other):
    first, second = numbers([0, other[0]], [0, other[1]], stream_key("input", 0.0, 0), 4)
    assert (first != second).all()


def test_no_two_paths_of_any_stream_draw_the_same_numbers(llvm):
    pixel, sample = np.indices((40, 40)).reshape(2, -1)
    drawn = [numbers(pixel, sample, stream_key(s, 0.0, 0), 4) for s in STREAMS]
    # four numbers of 24 bits: 8000 paths agree in all by chance once in 10^21
    assert len(np.unique(np.concatenate(drawn), axis=0)) == 5 * 40 * 40
