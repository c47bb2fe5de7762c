"""Rows of a cell's times: the parts of a frame, which add up, and how far they can be trusted.

    frame_ms = gbuffer_ms + plan_ms + allocate_ms + sampling_ms + denoise_ms
    inference_ms = plan_ms + allocate_ms + denoise_ms

The parts of inference are averages over the same frames of a row, the middle half by inference
time. Percentiles are of all frames, and do not add up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from rlbench.benchmark.cost import Cost
from rlbench.benchmark.cost_profile import ProfileTime
from rlbench.benchmark.latency import PARTS, Timing
from rlbench.benchmark.results import CLOCK_PREFIX, TWO_DEVICES, UNRELIABLE, Row

__all__ = ["failed_time_rows", "timing_rows", "drop_times"]

PERCENTILES = ("plan", "allocate", "denoise", "inference", "sample_fetch")
SUM = "gbuffer + plan + allocate + sampling + denoise"


@dataclass(frozen=True)
class _Inference:
    """The parts of inference that a row is charged, and how they were obtained."""

    parts: dict[str, float]
    convention: str
    note: str
    device: str  # that ran the method

    @property
    def total(self) -> float:
        return sum(self.parts.values())


def timing_rows(
    template: Row, timing: Timing, cost: Cost, published: ProfileTime | None = None
) -> list[Row]:
    """Rows of a cell's times: of the method, of a sample, of the G-buffer and of the whole frame.

    `template` has the mean_spp. A `published` inference time replaces the measured one, split as
    measured here; percentiles stay those of this device.
    """
    row = replace(template, unit="ms", direction="lower")
    inference = _inference(row, timing, published)
    sampling = row.mean_spp * cost.sample_ms * cost.scatter.factor
    is_unknown = math.isnan(cost.sample_ms) or cost.note.startswith(UNRELIABLE)
    sample_note = cost.note if is_unknown else ""
    note = _frame_note(inference, cost, sample_note)
    frame = cost.gbuffer_ms + inference.total + sampling
    source = f"{SUM}; inference on {inference.device}; samples: {cost.convention}"
    factor = f"; x {cost.scatter.factor:.3g} for scattered samples" * (cost.scatter.factor != 1)
    return [
        *(
            _with_value(row, f"{name}_ms", ms, inference.convention, inference.note)
            for name, ms in {**inference.parts, "inference": inference.total}.items()
        ),
        *_percentile_rows(row, timing),
        *_clock_rows(template, timing),
        _with_value(row, "gbuffer_ms", cost.gbuffer_ms, cost.gbuffer_convention),
        _with_value(row, "sample_ms", cost.sample_ms, cost.convention, cost.note),
        _with_value(
            row,
            "sampling_ms",
            sampling,
            f"{cost.convention}{factor}",
            sample_note or cost.scatter.note,
        ),
        _with_value(row, "frame_ms", frame, source, note),
    ]


def failed_time_rows(template: Row, reason: str) -> list[Row]:
    """The rows of a cell whose times an error prevented."""
    row = replace(template, unit="ms", direction="lower")
    names = (*PARTS, "inference", "sampling", "frame")
    return [_with_value(row, f"{name}_ms", math.nan, "not measured", reason) for name in names]


def drop_times(rows: Sequence[Row]) -> list[Row]:
    """The rows that are not times, unchanged."""
    return [row for row in rows if row.unit != "ms" and not row.metric.startswith(CLOCK_PREFIX)]


def _inference(row: Row, timing: Timing, published: ProfileTime | None) -> _Inference:
    parts = {name: getattr(timing, name).mean for name in PARTS}
    if published is None:
        convention = f"mean of the middle half of {_describe_frames(timing)}"
        note = _reliability_note(timing)
        return _Inference(parts, convention, note, row.device)
    total, device = sum(parts.values()), published.convention.partition(",")[0]
    shares = {name: ms / total for name, ms in parts.items()} if total else {"denoise": 1.0}
    parts = {name: published.ms * shares.get(name, 0.0) for name in PARTS}
    convention = f"{published.convention}; split into parts as measured on {row.device}"
    return _Inference(parts, convention, "", device)


def _frame_note(inference: _Inference, cost: Cost, sample_note: str) -> str:
    """Why a frame's time is missing or unreliable, and whether two devices share it."""
    if math.isnan(cost.sample_ms):
        return sample_note
    notes = [inference.note or sample_note]
    if cost.device and not _is_same_device(inference.device, cost.device):
        notes.append(f"{TWO_DEVICES} inference of {inference.device}, samples of {cost.device}")
    return "; ".join(filter(None, notes))


def _is_same_device(first: str, second: str) -> bool:
    """Are these names of one device, with its threads or cores after the last comma or not?"""
    return first.rpartition(",")[0] == second.rpartition(",")[0] and (
        "," in first or first == second
    )


def _reliability_note(timing: Timing) -> str:
    """The note of times that must not be believed; empty for others."""
    return f"{UNRELIABLE} {timing.unreliable}" if timing.unreliable else ""


def _percentile_rows(row: Row, timing: Timing) -> Iterator[Row]:
    frames = _describe_frames(timing)
    note = _reliability_note(timing)
    for name in PERCENTILES:
        time, is_fetch = getattr(timing, name), name == "sample_fetch"
        excluded = "; not part of frame_ms" * is_fetch
        remark = "" if is_fetch else note
        p50 = "sample_fetch_ms" if is_fetch else f"{name}_p50_ms"
        yield _with_value(row, p50, time.p50, f"median of {frames}{excluded}", remark)
        yield _with_value(row, f"{name}_p95_ms", time.p95, f"p95 of {frames}{excluded}", remark)


def _clock_rows(template: Row, timing: Timing) -> Iterator[Row]:
    """What the clock saw of the machine; a number that the system does not have has no row."""
    numbers = {
        "frames": (timing.frames, "timed frames that the times are of"),
        "rounds": (timing.rounds, "rounds that these frames come from"),
        "interval": (timing.half_width, "half width of the 95 % interval / median inference"),
        "processor_share": (timing.processor_share, "processor time / wall time of inference"),
        "calibration": (timing.calibration_ratio, "calibration kernel / that of a quiet moment"),
        "context_switches": (timing.switches, "involuntary context switches per frame"),
        "load": (timing.load_average, "load average of one minute before the first round"),
        "threads": (timing.threads, "threads of torch"),
    }
    for name, (value, convention) in numbers.items():
        if math.isfinite(value):
            yield _with_value(template, f"{CLOCK_PREFIX}{name}", float(value), convention)


def _describe_frames(timing: Timing) -> str:
    return f"{timing.frames} frames of {timing.clip} in {timing.rounds} rounds"


def _with_value(row: Row, metric: str, value: float, convention: str, note: str = "") -> Row:
    """The row with a number; a value that is not finite becomes nan with a note."""
    if not math.isfinite(value):
        note, value = note or f"the value is {value}", math.nan
    return replace(row, metric=metric, value=value, convention=convention, note=note)
