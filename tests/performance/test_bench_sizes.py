"""Cost of a sample and of the G-buffer by size: prints a table of docs/concepts/tracing.md."""

from __future__ import annotations

import pytest

from rlbench.apps.render.jobs.render_clips import scene_of_clip
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.variant import select_variant

SIZES = ((192, 192), (720, 1280), (1080, 1920))  # height, width
SCENES = ("temple", "city", "hall", "ripples")
ROUNDS = 3
STEPS = ("sample", "G-buffer")
COLUMNS = ("scene", *(f"{step}, {w}x{h} [ms]" for step in STEPS for h, w in SIZES))


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("size", SIZES, ids="{0[1]}x{0[0]}".format)
@pytest.mark.parametrize("step", STEPS)
def test_full_frame(benchmark, table, scene, size, step):
    """One sample of every pixel, left on the device that traces, or all four buffers."""
    select_variant()
    tracer = open_tracer(scene_of_clip(scene), *size)
    work = {"sample": lambda: tracer.trace_frame(1), "G-buffer": lambda: render_gbuffer(tracer)}
    result = benchmark.pedantic(work[step], rounds=ROUNDS, warmup_rounds=1)
    rounded = float(f"{1e3 * benchmark.stats.stats.median:.3g}")
    table[scene][f"{step}, {size[1]}x{size[0]} [ms]"] = f"{rounded:g}"
    assert (
        len(result[0] if step == "sample" else result)
        == {
            "sample": size[0] * size[1],
            "G-buffer": 4,
        }[step]
    )
