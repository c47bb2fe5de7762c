"""Cost of path tracing: prints the table of docs/concepts/tracing.md, one row per scene."""

from __future__ import annotations

import statistics
import time

import numpy as np
import pytest
import torch

from rlbench.apps.render.jobs.live_pool import LivePool
from rlbench.apps.render.jobs.render_clips import scene_of_clip
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.frames import Samples

SIDE = 720
SMALL = 96  # for tracing without LLVM
ROUNDS = 5
SCENES = ("temple", "city", "hall", "ripples")
COLUMNS = (
    *("scene", "full frame, 1 spp [ms]", "8 spp at once, each [ms]", "live, 0.01 spp [ms]"),
    *("live, 1 spp / full frame", "kernels compiled live", "moving [ms]", "G-buffer [ms]"),
    "without LLVM / with",
)


@pytest.fixture(scope="module", params=SCENES)
def tracer(request):
    select_variant()
    return open_tracer(scene_of_clip(request.param), SIDE, SIDE)


@pytest.fixture
def pool(tracer):
    tracer.set_time(0.0)
    return LivePool(tracer, 0.0, tuple(range(8)), 1, 1.0, torch.float16, torch.device("cpu"))


@pytest.fixture
def row(tracer, table):
    """The cells of the scene."""
    return table[tracer.scene.name]


def counts(spp):
    """A random map of sample counts; computing it is not measured."""
    random = np.random.default_rng(0)
    chosen = random.integers(0, SIDE * SIDE, round(spp * SIDE * SIDE))
    limited = np.minimum(np.bincount(chosen, minlength=SIDE * SIDE), 8)
    return torch.from_numpy(limited.reshape(1, 1, SIDE, SIDE))


def median_ms(benchmark, work):
    """Median time of `work` after one warm-up round, and its result."""
    result = benchmark.pedantic(work, rounds=ROUNDS, warmup_rounds=1)
    return 1e3 * benchmark.stats.stats.median, result


def timed(times, work):
    """Do the work, and note how long it took."""
    start = time.perf_counter()
    work()
    times.append(time.perf_counter() - start)


@pytest.mark.parametrize("spp", [1, 8])
def test_full_frame(benchmark, tracer, row, spp):
    ms, stack = median_ms(benchmark, lambda: tracer.trace_images(spp))
    row[COLUMNS[1 + (spp == 8)]] = f"{ms / spp:.0f}"
    assert np.isfinite(stack).all()


def test_live(benchmark, pool, row):
    count_map = counts(0.01)
    ms, radiance = median_ms(benchmark, lambda: pool.read(pool.empty(), count_map))
    row["live, 0.01 spp [ms]"] = f"{ms:.0f}"
    assert torch.equal(Samples(radiance, count_map).valid_mask.any(1), count_map > 0)
    assert torch.isfinite(radiance).all()


def test_live_against_a_full_frame(benchmark, pool, row):
    """Alternating, so that other load on the machine slows both."""
    count_map, full = counts(1.0), []

    def live():
        pool.read(pool.empty(), count_map)

    live()
    full_frame = {"setup": lambda: timed(full, lambda: pool.tracer.trace_images(1))}
    benchmark.pedantic(live, **full_frame, rounds=2 * ROUNDS)
    paths = int(count_map.sum()) / SIDE**2  # at most 8 per pixel
    ratio = benchmark.stats.stats.median / paths / statistics.median(full)
    row["live, 1 spp / full frame"] = f"{ratio:.2f}"


def test_kernels_compiled_live(benchmark, pool, row):
    import drjit as dr

    pool.read(pool.empty(), counts(1.0))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for spp in (0.0, 1 / SIDE**2, 0.01, 0.3, 1.0):
            pool.read(pool.empty(), counts(spp))
        kernels = dr.kernel_history([dr.KernelType.JIT])
    compiled = sum(not kernel["cache_hit"] for kernel in kernels)
    row["kernels compiled live"] = f"{compiled} of {len(kernels)} launched"
    benchmark.pedantic(lambda: None, rounds=1)  # counted, not timed
    assert compiled == 0
    assert len(kernels) == 4


@pytest.mark.parametrize("step", ["moving", "G-buffer"])
def test_before_any_path(benchmark, tracer, row, step):
    times = iter(range(1, 100))
    steps = {
        "moving": lambda: tracer.set_time(next(times)),
        "G-buffer": lambda: render_gbuffer(tracer),
    }
    ms, _ = median_ms(benchmark, steps[step])
    row[f"{step} [ms]"] = f"{ms:.0f}"


@pytest.mark.parametrize("name", SCENES)
def test_without_llvm(benchmark, table, name):
    """Full images at 8 spp, as references are rendered."""
    fast, times = open_tracer(scene_of_clip(name), SMALL, SMALL), []
    fast.trace_mean(8, "pilot")
    for _ in range(ROUNDS):
        timed(times, lambda: fast.trace_mean(8, "pilot"))
    select_variant("scalar_rgb")
    try:
        slow = open_tracer(scene_of_clip(name), SMALL, SMALL)
        ms, _ = median_ms(benchmark, lambda: slow.trace_mean(8, "pilot"))
    finally:
        select_variant("llvm_ad_rgb")
    table[name]["without LLVM / with"] = f"{ms / 1e3 / statistics.median(times):.1f}"
