"""The times of a clip's tracer: of a sample per pixel, with percentiles, and of a G-buffer.

They are measured by themselves, after the clip is rendered.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rlbench.clips.header import Header
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.open_tracer import Tracer, describe_tracer

__all__ = ["TraceTimes", "measure_trace_times"]

REPEATS = 9  # frames at one sample per pixel
GBUFFER_REPEATS = 3


class TraceTimes(NamedTuple):
    """Milliseconds of a full frame at one sample per pixel, and of a G-buffer."""

    sample_p5_ms: float
    sample_ms: float  # the median
    sample_p95_ms: float
    gbuffer_ms: float  # of the four standard buffers
    timed_with: str  # tracer variant and threads

    def written_to(self, header: Header) -> Header:
        """The header with these times."""
        return replace(header, **self._asdict())


def measure_trace_times(tracer: Tracer) -> TraceTimes:
    """The times of a tracer on this machine; the machine must be idle."""
    times = tracer.measure_ms(lambda: tracer.trace_images(1, "pilot"), REPEATS)
    gbuffers = tracer.measure_ms(lambda: render_gbuffer(tracer), GBUFFER_REPEATS)
    p5, p50, p95 = np.percentile(times, [5, 50, 95]).tolist()
    return TraceTimes(p5, p50, p95, float(np.median(gbuffers)), describe_tracer())
