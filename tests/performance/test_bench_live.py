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
    "full frame, 1 spp [ms]",
    "8 spp at once, each [ms]",
    "live, 0.01 spp [ms]",
    "live, 1 spp / full frame",
    "kernels compiled live",
    "moving [ms]",
    "G-buffer [ms]",
    "without LLVM / with",
)


@pytest.fixture(scope="module")
def table(request):
    """Cells by scene and column; printed at the end."""
    cells: dict[tuple[str, str], str] = {}
    yield cells
    lines = [f"| scene | {' | '.join(COLUMNS)} |", f"|---|{'---:|' * len(COLUMNS)}"]
    for scene in sorted({scene for scene, _ in cells}, key=SCENES.index):
        row = [cells.get((scene, column), "") for column in COLUMNS]
        lines.append(f"| {scene} | {' | '.join(row)} |")
    with request.config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
        print("", *lines, sep="\n")  # noqa: T201


@pytest.fixture(scope="module", params=SCENES)
def tracer(request):
    select_variant()
    return open_tracer(scene_of_clip(request.param), SIDE, SIDE)


@pytest.fixture
def pool(tracer):
    tracer.set_time(0.0)
    return LivePool(tracer, 0.0, tuple(range(8)), 1, 1.0, np.float16, torch.device("cpu"))


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


@pytest.mark.parametrize("spp", [1, 8])
@pytest.mark.benchmark(group="full frame")
def test_full_frame(benchmark, tracer, table, spp):
    ms, stack = median_ms(benchmark, lambda: tracer.trace_images(spp))
    table[tracer.scene.name, COLUMNS[spp == 8]] = f"{ms / spp:.0f}"
    assert np.isfinite(stack).all()


@pytest.mark.parametrize("spp", [0.01, 0.1, 1.0, 2.0])
@pytest.mark.benchmark(group="live")
def test_live(benchmark, pool, table, spp):
    count_map = counts(spp)
    ms, radiance = median_ms(benchmark, lambda: pool.read(pool.empty(), count_map))
    if spp == 0.01:
        table[pool.tracer.scene.name, COLUMNS[2]] = f"{ms:.0f}"
    assert torch.equal(Samples(radiance, count_map).valid_mask.any(1), count_map > 0)
    assert torch.isfinite(radiance).all()


@pytest.mark.benchmark(group="live against a full frame")
def test_live_against_a_full_frame(benchmark, pool, table):
    """Alternating, so that other load on the machine slows both."""
    count_map, full = counts(1.0), []

    def full_frame():
        start = time.perf_counter()
        pool.tracer.trace_images(1)
        full.append(time.perf_counter() - start)

    pool.read(pool.empty(), count_map)
    benchmark.pedantic(
        lambda: pool.read(pool.empty(), count_map), setup=full_frame, rounds=2 * ROUNDS
    )
    paths = int(count_map.sum()) / SIDE**2  # at most 8 per pixel
    ratio = benchmark.stats.stats.median / paths / statistics.median(full)
    benchmark.extra_info["live / full frame"] = ratio
    table[pool.tracer.scene.name, COLUMNS[3]] = f"{ratio:.2f}"
    assert ratio > 0


@pytest.mark.benchmark(group="kernels")
def test_kernels_compiled_live(benchmark, pool, table):
    import drjit as dr

    pool.read(pool.empty(), counts(1.0))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for spp in (0.0, 1 / SIDE**2, 0.01, 0.3, 1.0):
            pool.read(pool.empty(), counts(spp))
        kernels = dr.kernel_history([dr.KernelType.JIT])
    compiled = sum(not kernel["cache_hit"] for kernel in kernels)
    table[pool.tracer.scene.name, COLUMNS[4]] = f"{compiled} of {len(kernels)} launched"
    benchmark.extra_info["compiled"] = compiled
    benchmark.pedantic(lambda: None, rounds=1)  # counted, not timed
    assert compiled == 0
    assert len(kernels) == 4


@pytest.mark.parametrize("step", ["moving", "G-buffer"])
@pytest.mark.benchmark(group="before any path")
def test_before_any_path(benchmark, tracer, table, step):
    times = iter(range(1, 100))
    steps = {
        "moving": lambda: tracer.set_time(next(times)),
        "G-buffer": lambda: render_gbuffer(tracer),
    }
    ms, _ = median_ms(benchmark, steps[step])
    table[tracer.scene.name, f"{step} [ms]"] = f"{ms:.0f}"


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.benchmark(group="without LLVM")
def test_without_llvm(benchmark, table, name):
    """Full images at 8 spp, as references are rendered."""
    fast = open_tracer(scene_of_clip(name), SMALL, SMALL)
    fast.trace_mean(8, "pilot")
    full = []

    def with_llvm():
        start = time.perf_counter()
        fast.trace_mean(8, "pilot")
        full.append(time.perf_counter() - start)

    for _ in range(ROUNDS):
        with_llvm()
    select_variant("scalar_rgb")
    try:
        slow = open_tracer(scene_of_clip(name), SMALL, SMALL)
        ms, _ = median_ms(benchmark, lambda: slow.trace_mean(8, "pilot"))
    finally:
        select_variant("llvm_ad_rgb")
    table[name, COLUMNS[7]] = f"{ms / 1e3 / statistics.median(full):.1f}"
