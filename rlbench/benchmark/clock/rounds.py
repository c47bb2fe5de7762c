"""Rounds: every row runs a few frames in turn, between calibrations, until its time is steady.

A drift of the machine therefore meets all rows alike, and a busy phase is left out and repeated.
Each row keeps one running clip, so that its frames have real states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from rlbench.benchmark.clock.calibration import Calibration, Calibrator
from rlbench.benchmark.clock.reliability import is_steady
from rlbench.benchmark.clock.stopwatch import FrameTime

__all__ = ["Limits", "Session", "Track"]

UNTIMED, TIMED = 1, 3  # frames of a row in each round
MIN_ROUNDS = 3
MAX_SECONDS = 20.0  # of one row, once it has `min_rounds`
MAX_STRETCH_MS = 500.0  # between two calibrations, if a row's visit takes no longer
WARM_UP = 2  # calibrations before the first that counts


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
    spent_ms: float = 0.0
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
        track.visits.append(Visit(readings[UNTIMED:], len(self.calibrations) - 1))
        track.spent_ms += self._now() - start

    def _calibrate(self) -> None:
        self.calibrations.append(self.calibrator.measure())
        self._calibrated_at = self._now()

    def _is_finished(self, track: Track) -> bool:
        """Is the time of a track steady, or has it had all rounds that it may have?"""
        counted, least = self.select_quiet_visits(track), self.limits.min_rounds
        times = [frame.inference for visit in counted for frame in visit.frames]
        if len(counted) >= least and is_steady(times):
            return True
        is_late = track.spent_ms > 1e3 * self.limits.max_seconds and len(track.visits) >= least
        return is_late or len(track.visits) >= self.limits.max_rounds

    def _now(self) -> float:
        return self.calibrator.clock.wall_ms()
