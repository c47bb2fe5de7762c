"""Cost of a ReSTIR sample: a frame of sample streams against as many path-traced samples."""

from __future__ import annotations

import pytest

from baselines.restir import POOL
from rlbench.apps.render.jobs.extra_pools import open_streams
from rlbench.apps.render.jobs.render_clips import scene_of_clip
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.variant import select_variant

SIDE = 192
COUNT = 4  # samples per pixel
ROUNDS = 5


@pytest.fixture(scope="module")
def tracer():
    if select_variant().startswith("scalar"):
        pytest.skip("sample streams need LLVM or CUDA")
    return open_tracer(scene_of_clip("hall"), SIDE, SIDE)


@pytest.mark.benchmark(group=f"{COUNT} samples per pixel, hall")
@pytest.mark.parametrize("kind", ["streams", "paths"])
def test_samples(benchmark, tracer, kind):
    pool = open_streams(tracer, POOL, COUNT)
    frame = pool if kind == "streams" else lambda: tracer.trace_images(COUNT, "pilot")
    benchmark.pedantic(frame, rounds=ROUNDS, warmup_rounds=2)
