"""Measures the times of a rendered clip's tracer again, on an idle machine."""

from __future__ import annotations

import gc
import math
from dataclasses import replace
from pathlib import Path

from rlbench.clips.stored import ClipError, Header, read_header, write_header
from rlbench.render.jobs.render_clips import scene_of_clip
from rlbench.render.jobs.trace_times import measure_trace_times
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.system.provenance import machine

__all__ = ["remeasure_sample_ms"]


def remeasure_sample_ms(folder: Path) -> Header:
    """Measure the times of a clip of an installed scene, write its header and return it.

    These are `sample_ms`, its percentiles and `gbuffer_ms`. The times of other pools keep their
    ratio to the path tracer's, because that ratio was measured in alternating pairs, which other
    load on the machine slows alike. Pixels do not change. Raises ClipError if another machine
    rendered the clip.
    """
    header, this_machine = read_header(folder), machine().name
    if header.device != this_machine:
        raise ClipError(
            f"clip {folder} was rendered on '{header.device}', so its time per sample cannot be "
            f"measured on '{this_machine}'. Run this on '{header.device}'; `rlbench run --cost "
            "measured` times samples on this machine"
        )
    size = header.height, header.width
    tracer = open_tracer(scene_of_clip(header.name).inspect(header.frames, size), *size)
    times = measure_trace_times(tracer)
    del tracer
    gc.collect()  # while the old scene is alive, Dr.Jit compiles kernels for the next one again
    ratio = times.sample_ms / header.sample_ms if header.sample_ms > 0 else math.nan
    others = (ms * ratio for ms in header.pools_ms[1:])  # the path tracer's pool comes first
    pools_ms = (times.sample_ms, *others) if header.pools_ms else ()
    remeasured = replace(times.written_to(header), pools_ms=pools_ms)
    write_header(folder, remeasured)
    return remeasured
