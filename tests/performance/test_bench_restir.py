"""A frame of ReSTIR chains beside as many paths: what `restir` pays for a sample."""

from __future__ import annotations

import pytest

from baselines.restir import POOL
from rlbench.render.jobs.extra_pools import chains
from rlbench.render.jobs.render_clips import scene_of_clip
from rlbench.render.mitsuba.llvm import select_variant
from rlbench.render.mitsuba.open_tracer import open_tracer

SIDE = 192
COUNT = 4  # samples per pixel
ROUNDS = 5


@pytest.fixture(scope="module")
def tracer():
    if select_variant().startswith("scalar"):
        pytest.skip("chains are traced with LLVM or CUDA alone")
    return open_tracer(scene_of_clip("hall"), SIDE, SIDE)


@pytest.mark.benchmark(group=f"{COUNT} samples per pixel, hall")
@pytest.mark.parametrize("what", ["chains", "paths"])
def test_samples(benchmark, tracer, what):
    pool = chains(tracer, POOL, COUNT)
    frame = pool if what == "chains" else lambda: tracer.trace_images(COUNT, "pilot")
    benchmark.pedantic(frame, rounds=ROUNDS, warmup_rounds=2)
