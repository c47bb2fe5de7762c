"""Timing the samples of a clip anew: it was measured beside whatever else ran then."""

from __future__ import annotations

import gc
import math
from dataclasses import replace
from pathlib import Path

from rlbench.clips.stored import ClipError, Header, read_header, write_header
from rlbench.render.jobs.render_clips import scene_of_clip
from rlbench.render.mitsuba.open_tracer import sample_ms
from rlbench.system.provenance import machine


def remeasure_sample_ms(folder: Path) -> Header:
    """The header of a clip of an installed scene, whose samples are timed now, and written.

    Those of pools beside the path tracer's cost as many times a path's as before: that was measured
    in pairs, which other work on the machine slows alike. Pixels are not touched. Raises ClipError
    for a clip that another machine has rendered: its times are of there.
    """
    header, here = read_header(folder), machine().name
    if header.device != here:
        raise ClipError(
            f"clip {folder} was rendered on '{header.device}', and --retime runs on '{here}'; "
            "`rlbench run --cost measured` times its samples here by itself"
        )
    taken = sample_ms(scene_of_clip(header.name), header.height, header.width)
    gc.collect()  # a scene that is still alive makes Dr.Jit compile the next one again
    slower = taken / header.sample_ms if header.sample_ms > 0 else math.nan
    others = (each * slower for each in header.pools_ms[1:])  # the path tracer's comes first
    pools_ms = (taken, *others) if header.pools_ms else ()
    told = replace(header, sample_ms=taken, pools_ms=pools_ms)
    write_header(folder, told)
    return told
