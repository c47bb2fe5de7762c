"""What tracing costs: prints the table of docs/tracing.md, a row for each scene."""

from __future__ import annotations

import statistics
import time

import numpy as np
import pytest
import torch

from rlbench.frames import Samples
from rlbench.render.jobs.live_pool import LivePool
from rlbench.render.jobs.render_clips import scene_of_clip
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.llvm import select_variant
from rlbench.render.mitsuba.open_tracer import open_tracer

SIDE = 720
SMALL = 96  # for what is slow without LLVM
ROUNDS = 5
SCENES = ("temple", "city", "hall", "ripples")
COLUMNS = (
    "full frame, 1 spp [ms]",
    "8 spp at once, each [ms]",
    "live, 0.01 spp [ms]",
    "live, 1 spp / full frame",
    "kernels compiled live",
    "moving [ms]",
    "view [ms]",
    "without LLVM / with",
)


@pytest.fixture(scope="module")
def table(request):
    """Cells by scene and column; at the end, what there is of them is printed."""
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
    """A map that no pixel order explains; what deciding on it costs is not measured."""
    random = np.random.default_rng(0)
    chosen = random.integers(0, SIDE * SIDE, round(spp * SIDE * SIDE))
    found = np.minimum(np.bincount(chosen, minlength=SIDE * SIDE), 8)
    return torch.from_numpy(found.reshape(1, 1, SIDE, SIDE))


def median_ms(benchmark, work):
    """Median time of `work`, after one that does not count."""
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
    wanted = counts(spp)
    ms, radiance = median_ms(benchmark, lambda: pool.take(pool.empty(), wanted))
    if spp == 0.01:
        table[pool.tracer.scene.name, COLUMNS[2]] = f"{ms:.0f}"
    assert torch.equal(Samples(radiance, wanted).valid_mask.any(1), wanted > 0)
    assert torch.isfinite(radiance).all()


@pytest.mark.benchmark(group="live against a full frame")
def test_live_against_a_full_frame(benchmark, pool, table):
    """In turns, so that whatever else the machine does slows both."""
    wanted, full = counts(1.0), []

    def full_frame():
        start = time.perf_counter()
        pool.tracer.trace_images(1)
        full.append(time.perf_counter() - start)

    pool.take(pool.empty(), wanted)
    benchmark.pedantic(lambda: pool.take(pool.empty(), wanted), setup=full_frame, rounds=2 * ROUNDS)
    paths = int(wanted.sum()) / SIDE**2  # a pixel has 8 at most
    ratio = benchmark.stats.stats.median / paths / statistics.median(full)
    benchmark.extra_info["live / full frame"] = ratio
    table[pool.tracer.scene.name, COLUMNS[3]] = f"{ratio:.2f}"
    assert ratio > 0


@pytest.mark.benchmark(group="kernels")
def test_kernels_compiled_live(benchmark, pool, table):
    import drjit as dr

    pool.take(pool.empty(), counts(1.0))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for spp in (0.0, 1 / SIDE**2, 0.01, 0.3, 1.0):
            pool.take(pool.empty(), counts(spp))
        kernels = dr.kernel_history([dr.KernelType.JIT])
    compiled = sum(not kernel["cache_hit"] for kernel in kernels)
    table[pool.tracer.scene.name, COLUMNS[4]] = f"{compiled} of {len(kernels)} launched"
    benchmark.extra_info["compiled"] = compiled
    benchmark.pedantic(lambda: None, rounds=1)  # counted, not timed
    assert compiled == 0
    assert len(kernels) == 4


@pytest.mark.parametrize("what", ["moving", "view"])
@pytest.mark.benchmark(group="before any path")
def test_before_any_path(benchmark, tracer, table, what):
    times = iter(range(1, 100))
    work = {"moving": lambda: tracer.set_time(next(times)), "view": lambda: render_gbuffer(tracer)}[
        what
    ]
    ms, _ = median_ms(benchmark, work)
    table[tracer.scene.name, f"{what} [ms]"] = f"{ms:.0f}"


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.benchmark(group="without LLVM")
def test_without_llvm(benchmark, table, name):
    """Whole images of 8 spp, as a reference is made of."""
    fast = open_tracer(scene_of_clip(name), SMALL, SMALL)
    fast.trace_mean(8, "pilot")
    full = []

    def with_it():
        start = time.perf_counter()
        fast.trace_mean(8, "pilot")
        full.append(time.perf_counter() - start)

    for _ in range(ROUNDS):
        with_it()
    select_variant("scalar_rgb")
    try:
        slow = open_tracer(scene_of_clip(name), SMALL, SMALL)
        ms, _ = median_ms(benchmark, lambda: slow.trace_mean(8, "pilot"))
    finally:
        select_variant("llvm_ad_rgb")
    table[name, COLUMNS[7]] = f"{ms / 1e3 / statistics.median(full):.1f}"
