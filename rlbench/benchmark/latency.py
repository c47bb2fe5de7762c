"""Times of methods on this device, measured together: what a frame's inference takes.

`time_methods` runs all rows in interleaved rounds (`rlbench.benchmark.clock`) and summarises the
frames of each. The parts of a row are averages over the same frames, so that they add up.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import NamedTuple

import torch

from rlbench.benchmark.clock.calibration import (
    MIN_PROCESSOR_SHARE,
    Calibrator,
    load_average,
    make_kernel,
)
from rlbench.benchmark.clock.reliability import half_width, middle_half, unreliable_reason
from rlbench.benchmark.clock.rounds import Limits, Session, Track, Visit
from rlbench.benchmark.clock.stopwatch import (
    Clock,
    FrameTime,
    Stopwatch,
    SystemClock,
    TimedMethod,
    timed_reader,
)
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.run import run_clip
from rlbench.system import provenance
from rlbench.system.process_settings import keep_freed_memory

__all__ = ["PARTS", "REPEATS", "PartTime", "TimedRow", "Timing", "device_name", "time_methods"]

REPEATS = 10  # timed frames of a row, at least
PARTS = ("plan", "allocate", "denoise")  # of inference, in the order of a frame


class TimedRow(NamedTuple):
    """What is timed: a method on a clip at a budget. The clip restarts as often as needed."""

    method: Method
    clip: Clip
    target_spp: float


class PartTime(NamedTuple):
    """Time of a part of a frame, milliseconds."""

    mean: float  # of the middle half of the frames by inference time
    p50: float  # of all frames
    p95: float


@dataclass(frozen=True)
class Timing:
    """Times of one frame of a row, and how far they can be trusted."""

    clip: str  # name of the timed clip; clips that take the same time are timed once
    plan: PartTime
    allocate: PartTime  # density to counts, 0 for methods that do not adapt
    denoise: PartTime
    inference: PartTime  # plan + allocate + denoise; so are the means
    sample_fetch: PartTime  # reading stored samples; not part of a frame's time
    frames: int  # that the times are of
    rounds: int  # that these frames come from
    half_width: float  # of the 95 % interval of the median inference, relative to it
    processor_share: float  # processor time / wall time; up to the number of threads
    calibration_ratio: float  # median calibration of these rounds / that of a quiet moment
    switches: float  # involuntary context switches per frame
    load_average: float  # when the session began
    threads: int  # of torch
    unreliable: str = ""  # why the times must not be believed; empty if they may


def time_methods(
    rows: Sequence[TimedRow],
    device: torch.device,
    repeats: int = REPEATS,
    calibrator: Calibrator | None = None,
    on_done: Callable[[], None] = lambda: None,
) -> list[Timing | Exception]:
    """Times of each row, or what it raised, measured in interleaved rounds.

    Each row is timed over at least `repeats` frames, and more until the median of its inference is
    steady. `calibrator` replaces the clocks and the kernel of this machine. `on_done` is called
    whenever a row is finished.
    """
    keep_freed_memory()
    calibrator = calibrator or Calibrator(SystemClock(device), make_kernel(device))
    session, load = Session(calibrator, Limits.of_repeats(repeats)), load_average()
    tracks = [Track(_frames(row, calibrator.clock)) for row in rows]
    session.run(tracks, on_done)
    return [
        track.error or _summary(session, track, row.clip.name, load)
        for track, row in zip(tracks, rows, strict=True)
    ]


def device_name(device: torch.device) -> str:
    """Model name of a device; of a processor with its threads, because times depend on both."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    if device.type == "cpu":
        return f"{provenance.machine().cpu}, {torch.get_num_threads()} threads"
    return device.type


def _frames(row: TimedRow, clock: Clock) -> Iterator[FrameTime]:
    """The times of one frame after another, without end."""
    stopwatch = Stopwatch(clock)
    method, read = TimedMethod(row.method, stopwatch), timed_reader(stopwatch)
    clips = (run_clip(method, row.clip, row.target_spp, read) for _ in repeat(None))
    for _ in chain.from_iterable(clips):
        yield stopwatch.read_and_reset(row.method.traits.adaptive)


def _summary(session: Session, track: Track, clip: str, load: float) -> Timing:
    counted = session.select_quiet_visits(track)
    least = session.limits.min_rounds
    visits = counted if len(counted) >= least else track.visits
    frames = sorted(
        (frame for visit in visits for frame in visit.frames), key=lambda frame: frame.inference
    )
    middle, times = middle_half(frames), [frame.inference for frame in frames]
    parts = {name: _part_time(name, frames, middle) for name in (*PARTS, "sample_fetch")}
    inference = _part_time("inference", frames, middle)
    ratios = [each.ms / session.quiet_ms for visit in visits for each in session.around(visit)]
    busy = _describe_load(session, track.visits)
    return Timing(
        clip=clip,
        **parts,
        inference=inference._replace(mean=sum(parts[name].mean for name in PARTS)),
        frames=len(frames),
        rounds=len(visits),
        half_width=half_width(times) / inference.p50 if inference.p50 else 0.0,
        processor_share=sum(f.processor for f in frames) / (sum(times) or 1.0),
        calibration_ratio=statistics.median(ratios),
        switches=statistics.fmean(frame.switches for frame in frames),
        load_average=load,
        threads=torch.get_num_threads(),
        unreliable=unreliable_reason(times, len(counted), len(track.visits), least, busy),
    )


def _part_time(name: str, frames: Sequence[FrameTime], middle: Sequence[FrameTime]) -> PartTime:
    times = torch.tensor([getattr(frame, name) for frame in frames], dtype=torch.float64)
    p50, p95 = times.quantile(torch.tensor([0.5, 0.95], dtype=torch.float64)).tolist()
    return PartTime(statistics.fmean(getattr(frame, name) for frame in middle), p50, p95)


def _describe_load(session: Session, visits: Sequence[Visit]) -> str:
    """How busy the machine was at worst, as the calibrations saw it."""
    seen = [each for visit in visits for each in session.around(visit)]
    text = f"calibration up to {max(each.ms for each in seen) / session.quiet_ms:.1f} times "
    text += "a quiet moment"
    shares = [s for s in (each.processor_share for each in seen) if s < MIN_PROCESSOR_SHARE]
    return f"{text}, {min(shares):.0%} of the processor time it asked for" if shares else text
