"""Times of methods on this device, measured together: what a frame's inference takes.

`time_methods` runs all rows in interleaved rounds and summarises the frames of each: a row runs a
few frames in turn, between calibrations, until its time is steady. A drift of the machine therefore
meets all rows alike, and a busy phase is left out and repeated. Each row keeps one running clip, so
that its frames have real states. The parts of a row are averages over the same frames, so that they
add up. On a machine that is never quiet the time is an estimate (`rlbench.system.load`), and its
interval is wide.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, repeat
from typing import NamedTuple, TypeVar

import torch

from rlbench.benchmark.clock import (
    PARTS,
    Calibration,
    Calibrator,
    FrameTime,
    Stopwatch,
    SystemClock,
    TimedMethod,
    load_average,
    make_kernel,
    timed_reader,
)
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.run import run_clip
from rlbench.system import provenance
from rlbench.system.load import MIN_PROCESSOR_SHARE, estimate_quiet_ms, fastest_tenth
from rlbench.system.process_settings import keep_freed_memory

REPEATS = 10  # timed frames of a row, at least
UNTIMED, TIMED = 1, 3  # frames of a row in each round
MIN_ROUNDS = 3
MAX_SECONDS = 20.0  # of one row, once it has `min_rounds`
MAX_STRETCH_MS = 500.0  # between two calibrations, if a row's visit takes no longer
WARM_UP = 2  # calibrations before the first that counts
T = TypeVar("T")
LEVEL = 0.95  # of the interval of the median
TARGET = 0.02  # half width of the interval, relative to the median, at which measuring stops
ACCEPTED = 0.05  # half width of an interval beyond which a row's frames vary too much
FLOOR_MS = 0.05  # a half width that is small enough for any time


class TimedRow(NamedTuple):
    """What is timed: a method on a clip at a budget. The clip restarts as often as needed."""

    method: Method
    clip: Clip
    spp: float


class PartTime(NamedTuple):
    """Time of a part of a frame, milliseconds."""

    mean: float  # what a frame is charged, see `Timing.frames_used`
    p50: float  # of all frames
    p95: float


@dataclass(frozen=True)
class Timing:
    """Times of one frame of a row, and the interval in which they lie on a quiet machine."""

    clip: str  # name of the timed clip; clips that take the same time are timed once
    plan: PartTime
    allocate: PartTime  # density to counts, 0 for methods that do not adapt
    denoise: PartTime
    inference: PartTime  # plan + allocate + denoise; so are the means
    sample_fetch: PartTime  # reading stored samples; not part of a frame's time
    low: float  # of the interval of `inference.mean`, milliseconds
    high: float
    frames_used: str  # that the means are of, and what they were multiplied by
    frames: int  # that the times are of
    rounds: int  # that these frames come from
    half_width: float  # of the 95 % interval of the median inference, relative to it
    processor_share: float  # processor time / wall time; up to the number of threads
    calibration_ratio: float  # median calibration of these rounds / that of a quiet moment
    switches: float  # involuntary context switches per frame
    load_average: float  # when the session began
    threads: int  # of torch
    disturbance: str = ""  # what other programs did, or that frames vary; empty if neither
    device_share: float = math.nan  # time by a GPU's own clock / wall time; nan on a processor
    first_use_ms: float = 0.0  # of the first visit beyond later ones: recording, compiling


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
        threads = torch.get_num_threads()
        return f"{provenance.machine().cpu}, {threads} thread{'s' * (threads != 1)}"
    return device.type


def _frames(row: TimedRow, clock: SystemClock) -> Iterator[FrameTime]:
    """The times of one frame after another, without end."""
    stopwatch = Stopwatch(clock)
    method, read = TimedMethod(row.method, stopwatch), timed_reader(stopwatch)
    clips = (run_clip(method, row.clip, row.spp, read) for _ in repeat(None))
    for _ in chain.from_iterable(clips):
        yield stopwatch.read_and_reset(row.method.traits.adaptive)


def _summary(session: Session, track: Track, clip: str, load: float) -> Timing:
    quiet, least = session.select_quiet_visits(track), session.limits.min_rounds
    is_busy = len(quiet) < least
    visits = track.visits if is_busy else quiet
    frames = sorted(
        (frame for visit in visits for frame in visit.frames), key=lambda frame: frame.inference
    )
    times = [frame.inference for frame in frames]
    median, half, speed = statistics.median(times), half_width(times), 1.0
    counted, low, high = middle_half(frames), statistics.fmean(fastest_tenth(times)), median + half
    used = "middle half"
    if is_busy:
        counted, speed = fastest_tenth(frames), session.mean_speed(visits)
        _, low, high = estimate_quiet_ms(times, speed)
        used = f"{speed:.2f} x the fastest tenth"
    parts = {n: _part_time(n, frames, counted, speed) for n in (*PARTS, "sample_fetch")}
    inference = _part_time("inference", frames, counted, speed)
    ratios = [each.ms / session.quiet_ms for visit in visits for each in session.around(visit)]
    load_text = _describe_load(session, track.visits)
    return Timing(
        clip=clip,
        **parts,
        inference=inference._replace(mean=(mean := sum(parts[name].mean for name in PARTS))),
        low=min(low, mean),
        high=max(high, mean),
        frames_used=used,
        frames=len(frames),
        rounds=len(visits),
        half_width=half / inference.p50 if inference.p50 else 0.0,
        processor_share=sum(f.processor for f in frames) / (sum(times) or 1.0),
        device_share=sum(f.device for f in frames) / (sum(times) or 1.0),
        calibration_ratio=statistics.median(ratios),
        switches=statistics.fmean(frame.switches for frame in frames),
        load_average=load,
        threads=torch.get_num_threads(),
        disturbance=describe_disturbance(times, len(quiet), len(track.visits), least, load_text),
        first_use_ms=max(0.0, track.first_ms - track.spent_ms / max(len(track.visits) - 1, 1)),
    )


def _part_time(
    name: str, frames: Sequence[FrameTime], counted: Sequence[FrameTime], factor: float
) -> PartTime:
    times = torch.tensor([getattr(frame, name) for frame in frames], dtype=torch.float64)
    p50, p95 = times.quantile(torch.tensor([0.5, 0.95], dtype=torch.float64)).tolist()
    mean = statistics.fmean(getattr(frame, name) for frame in counted)
    return PartTime(factor * mean, p50, p95)


def _describe_load(session: Session, visits: Sequence[Visit]) -> str:
    """How busy the machine was at worst, as the calibrations saw it."""
    seen = [each for visit in visits for each in session.around(visit)]
    text = f"calibration up to {max(each.ms for each in seen) / session.quiet_ms:.1f} times "
    text += "a quiet moment"
    shares = [s for s in (each.processor_share for each in seen) if s < MIN_PROCESSOR_SHARE]
    return f"{text}, {min(shares):.0%} of the processor time it asked for" if shares else text


class Limits(NamedTuple):
    """How many rounds a row runs."""

    min_rounds: int
    max_rounds: int
    max_seconds: float = MAX_SECONDS

    @staticmethod
    def of_repeats(repeats: int) -> Limits:
        """Limits for at least `repeats` timed frames.

        >>> Limits.of_repeats(10)
        Limits(min_rounds=4, max_rounds=10, max_seconds=20.0)
        """
        least = max(MIN_ROUNDS, math.ceil(repeats / TIMED))
        return Limits(least, max(least, repeats))


class Visit(NamedTuple):
    """The timed frames of one row in one round."""

    frames: tuple[FrameTime, ...]
    calibration: int  # index of the calibration before; the next one is that after


@dataclass
class Track:
    """One row: its running frames, and what was measured of them."""

    frames: Iterator[FrameTime]  # endless
    visits: list[Visit] = field(default_factory=list)
    first_ms: float = 0.0  # of the first visit, in which a backend may record or compile
    spent_ms: float = 0.0  # of the later ones
    error: Exception | None = None
    is_done: bool = False


@dataclass
class Session:
    """Tracks that are measured together, and the calibrations between their visits."""

    calibrator: Calibrator
    limits: Limits
    calibrations: list[Calibration] = field(default_factory=list)
    _calibrated_at: float = 0.0

    def run(self, tracks: Sequence[Track], on_done: Callable[[], None] = lambda: None) -> None:
        """Measure all tracks; `on_done` is called for each that is steady, at its cap, or failed.

        A track whose frames raise an exception keeps it in `error`; the others go on.
        """
        for _ in range(WARM_UP):
            self.calibrator.measure()
        self._calibrate()
        while active := [track for track in tracks if not track.is_done]:
            for track in active:
                if self._now() - self._calibrated_at > MAX_STRETCH_MS:
                    self._calibrate()
                self._visit(track)
            self._calibrate()
            for track in active:
                track.is_done = track.error is not None or self._is_finished(track)
                if track.is_done:
                    on_done()

    @property
    def quiet_ms(self) -> float:
        """The kernel's time on the quiet machine: the lower quartile of all calibrations.

        Single readings may be lucky: on a quiet virtual machine the shortest of 40 took 0.70 times
        the median. A machine that is slower for more than three quarters of a session, but lets
        no thread wait, therefore counts as quiet.
        """
        times = sorted(calibration.ms for calibration in self.calibrations)
        return times[(len(times) - 1) // 4]

    def select_quiet_visits(self, track: Track) -> list[Visit]:
        """The visits of a track between two quiet calibrations."""
        quiet_ms = self.quiet_ms
        return [
            visit
            for visit in track.visits
            if all(each.is_quiet(quiet_ms) for each in self.around(visit))
        ]

    def mean_speed(self, visits: Sequence[Visit]) -> float:
        """Mean share of the quiet machine's speed around some visits."""
        quiet_ms = self.quiet_ms
        return statistics.fmean(
            each.speed(quiet_ms) for visit in visits for each in self.around(visit)
        )

    def around(self, visit: Visit) -> list[Calibration]:
        """The calibrations before and after a visit."""
        return self.calibrations[visit.calibration : visit.calibration + 2]

    def _visit(self, track: Track) -> None:
        start = self._now()
        try:
            readings = tuple(next(track.frames) for _ in range(UNTIMED + TIMED))
        except Exception as error:  # whatever a method may raise is the result of its row
            track.error = error
            return
        spent = self._now() - start
        if not track.visits:
            track.first_ms = spent
        else:
            track.spent_ms += spent
        track.visits.append(Visit(readings[UNTIMED:], len(self.calibrations) - 1))

    def _calibrate(self) -> None:
        self.calibrations.append(self.calibrator.measure())
        self._calibrated_at = self._now()

    def _is_finished(self, track: Track) -> bool:
        """True if the time of a track is steady, or it had all rounds that it may have."""
        counted, least = self.select_quiet_visits(track), self.limits.min_rounds
        times = [frame.inference for visit in counted for frame in visit.frames]
        if len(counted) >= least and is_steady(times):
            return True
        is_late = track.spent_ms > 1e3 * self.limits.max_seconds and len(track.visits) >= least
        return is_late or len(track.visits) >= self.limits.max_rounds

    def _now(self) -> float:
        return self.calibrator.clock.wall_ms()


def median_ranks(count: int, level: float = LEVEL) -> tuple[int, int] | None:
    """Ranks (from 0) of the order statistics that enclose the median with probability `level`.

    They hold for any distribution (Conover 1999, Practical Nonparametric Statistics, section 3.2).
    None for fewer values than such an interval needs.

    >>> median_ranks(6), median_ranks(20), median_ranks(5)
    ((0, 5), (5, 14), None)
    """
    tail, low = 0.0, -1
    while low < count:
        tail += math.comb(count, low + 1) / 2**count
        if tail > (1 - level) / 2:
            break
        low += 1
    return (low, count - 1 - low) if low >= 0 else None


def half_width(times: Sequence[float]) -> float:
    """Half the width of the interval of the median, in the units of `times`; inf for too few."""
    ranks = median_ranks(len(times))
    if ranks is None:
        return math.inf
    ordered = sorted(times)
    return (ordered[ranks[1]] - ordered[ranks[0]]) / 2


def is_steady(times: Sequence[float], target: float = TARGET) -> bool:
    """True if the median of these times, in milliseconds, is known well enough."""
    if not times:
        return False
    return half_width(times) <= max(FLOOR_MS, target * statistics.median(times))


def middle_half(ordered: Sequence[T]) -> Sequence[T]:
    """The items between the quartiles of an ordered sequence; at least one.

    >>> middle_half([1, 2, 3, 4, 5, 6, 7, 8])
    [3, 4, 5, 6]
    """
    cut = len(ordered) // 4
    return ordered[cut : len(ordered) - cut]


def describe_disturbance(
    times: Sequence[float], counted: int, rounds: int, min_rounds: int, busy: str
) -> str:
    """Why the interval of `times` is wide; empty on a quiet machine with steady frames.

    `counted` of `rounds` rounds ran on a quiet machine; `busy` says how busy it was otherwise.
    """
    if counted < min_rounds:
        return f"the machine was busy in {rounds - counted} of {rounds} rounds ({busy})"
    if is_steady(times, ACCEPTED):
        return ""
    share = half_width(times) / statistics.median(times)
    return (
        f"the {LEVEL:.0%} interval of the median is +-{share:.1%} after {counted} rounds, "
        f"above {ACCEPTED:.0%}"
    )
