"""Times and costs of a run's cells: measured before the scores, once for all that share them.

`measure_all` times the rows of all cells together, in interleaved rounds, on this machine, while
nothing else runs here. Cells are scored afterwards, in any order and on any machine. The rows of a
cell's times are the parts of a frame, which add up:

    frame_ms = gbuffer_ms + plan_ms + allocate_ms + sampling_ms + denoise_ms
    inference_ms = plan_ms + allocate_ms + denoise_ms

The parts of inference are averages over the same frames of a row, the middle half by inference
time. Percentiles are of all frames, and do not add up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, islice
from pathlib import Path
from typing import Any

from rlbench import registry
from rlbench.backends import EAGER
from rlbench.benchmark import cost, latency
from rlbench.benchmark.clock import PARTS
from rlbench.benchmark.cost import FULL_FRAME, Cost, Scatter
from rlbench.benchmark.cost_profile import CostProfile, ProfileTime
from rlbench.benchmark.latency import TimedRow, Timing
from rlbench.benchmark.results import (
    CLOCK_PREFIX,
    TWO_DEVICES,
    UNCERTAIN,
    WIDE,
    Row,
    interval_columns,
    uncertainty,
)
from rlbench.benchmark.run_plan import Cell, CellLoader
from rlbench.benchmark.sample_clock import SampleClock, open_clock
from rlbench.benchmark.scoring import with_value
from rlbench.parallel.executor import Executor, JobResult, ProgressCallback, Resources
from rlbench.run import run_clip
from rlbench.system import provenance

MAX_ROWS = 48  # timed in one session: the state of each is in memory
FRAMES = 3  # of the clip, so that a temporal method has a history; the last one's counts are traced
PERCENTILES = ("plan", "allocate", "denoise", "inference", "sample_fetch")
END = "{} end of the interval in which a quiet machine's time lies"
SUM = "gbuffer + plan + allocate + sampling + denoise"

TimingKey = tuple[object, ...]
Group = tuple[Cell, ...]
TimingCallback = Callable[[int, int], None]  # receives the number of timed rows, and of all


@dataclass(frozen=True)
class TimingCache:
    """Times of methods and costs of samples measured so far."""

    loader: CellLoader
    profile: CostProfile | None  # None: samples cost what they take on this machine
    _timings: dict[TimingKey, Timing] = field(default_factory=dict, repr=False)
    _costs: dict[tuple[object, ...], Cost] = field(default_factory=dict, repr=False)
    _scatters: dict[TimingKey, Scatter] = field(default_factory=dict, repr=False)

    def __call__(
        self, group: Group, on_progress: ProgressCallback
    ) -> list[JobResult[Cell, Timing]]:
        """Times of a group of cells, measured now: the work handed to an executor."""
        plan = self.loader.plan
        with registry.exits_as_errors():
            loaded = [self._load(cell) for cell in group]
            rows = [row for row in loaded if isinstance(row, TimedRow)]
            timed = iter(
                latency.time_methods(
                    rows, plan.device, plan.repeats, on_done=lambda: on_progress(1.0)
                )
            )
            outcomes = [next(timed) if isinstance(row, TimedRow) else row for row in loaded]
        return [
            JobResult(cell, error=each) if isinstance(each, Exception) else JobResult(cell, each)
            for cell, each in zip(group, outcomes, strict=True)
        ]

    def measure_all(
        self,
        cells: Iterable[Cell],
        executor: Executor,
        resources: Resources,
        on_timing: TimingCallback,
    ) -> list[tuple[Cell, Exception]]:
        """Measure all times and costs of `cells` on this machine; the cells that failed.

        Where one fails, the next cell with the same time is measured. `on_timing` is called
        whenever a row has its time.
        """
        runnable = [cell for cell in cells if not cell.incompatibility]
        errors: list[tuple[Cell, Exception]] = []
        waiting = runnable
        while waiting:
            firsts = list({self.key(cell): cell for cell in reversed(waiting)}.values())
            for outcome in self._time(firsts, executor, resources, on_timing):
                if outcome.error:
                    errors.append((outcome.job, outcome.error))
                else:
                    self._timings[self.key(outcome.job)] = outcome.result()
            waiting = [
                each
                for each in waiting
                if self.key(each) not in self._timings and each not in firsts
            ]
        self._measure_costs([cell for cell in runnable if self.key(cell) in self._timings])
        return errors

    def key(self, cell: Cell) -> TimingKey:
        """What a time depends on. Static clips are faster, because nothing is reprojected.

        Where unchanged tiles are kept, the time depends on the clip.
        """
        header = cell.header
        size, is_moving = (header.height, header.width), header.frames > 1 and not header.static
        fetched = header.pool_spp, cell.clip.cost_key
        content = header.name if cell.skip_tiles else ""
        return cell.method_name, size, cell.spp, is_moving, *fetched, content

    def timing(self, cell: Cell) -> Timing:
        """Times of a cell that `measure_all` has measured."""
        return self._timings[self.key(cell)]

    def published_inference(self, cell: Cell) -> ProfileTime | None:
        """Inference time of a cell by the profile; None where it has none of this row."""
        is_published = cell.backend == EAGER and not (cell.half or cell.skip_tiles)
        if self.profile is None or not is_published:
            return None
        return self.profile.inference(cell.method_name, cell.header.height, cell.header.width)

    def cost(self, cell: Cell) -> Cost:
        """Cost of a cell's samples and G-buffer, with the factor of its scattered samples."""
        header, pool, has_inputs = cell.header, cell.traits.pool, bool(cell.traits.inputs)
        key = (header.name, pool, has_inputs)
        if key not in self._costs:
            price = self._sample_cost(cell, pool)
            if has_inputs:
                path = price if pool == "path" else self._sample_cost(cell, "path")
                price = cost.with_gbuffer(price, path.sample_ms, header)
            self._costs[key] = price
        shared = self.key(cell)
        own = self._scatters.get((*shared, header.name))
        scatter = own or self._scatters.get(shared, FULL_FRAME)
        return replace(self._costs[key], scatter=scatter)

    def _measure_costs(self, cells: Sequence[Cell]) -> None:
        """Measure what samples cost at the counts of adaptive methods, and all other costs.

        The factor of a method at a budget is that of one clip, as its time is. A clip without a
        factor has a note of its own, which is no other clip's. A cost profile has no such factor,
        and samples of other pools are not traced one by one.
        """
        meter = ScatterMeter(self.loader)
        for cell in cells:
            self.cost(cell)
            is_scattered = cell.traits.adaptive and cell.traits.pool == "path"
            if self.profile is None and is_scattered:
                with registry.exits_as_errors():
                    self._measure_scatter(cell, meter)

    def _measure_scatter(self, cell: Cell, meter: ScatterMeter) -> None:
        shared = self.key(cell)
        own = (*shared, cell.header.name)
        is_shared = shared in self._scatters and meter.has_scene(cell)
        if not is_shared and own not in self._scatters:
            measured = meter.measure(cell)
            self._scatters[own if measured.note else shared] = measured

    def _sample_cost(self, cell: Cell, pool: str) -> Cost:
        if self.profile:
            return cost.published(self.profile, cell.header, pool)
        return cost.measured(cell.header, provenance.machine().name, pool)

    def _time(
        self,
        cells: Sequence[Cell],
        executor: Executor,
        resources: Resources,
        on_timing: TimingCallback,
    ) -> Iterator[JobResult[Cell, Timing]]:
        """The times of cells, each group measured together.

        A method may end the process or the program of its group. Then each of the group's rows is
        measured by itself.
        """
        done = 0.0

        def on_progress(rows: float) -> None:
            nonlocal done
            done = min(done + rows, len(cells))
            on_timing(round(done), len(cells))

        alone, groups = executor.local_exclusive(), _groups(cells)
        if cells:
            on_timing(0, len(cells))  # the first row may be done minutes later
        for outcome in alone.map(self, groups, resources, on_progress):
            if outcome.error is None:
                yield from outcome.result()
                continue
            for single in alone.map(self, [(cell,) for cell in outcome.job], resources):
                (cell,) = single.job
                yield JobResult(cell, error=single.error) if single.error else single.result()[0]

    def _load(self, cell: Cell) -> TimedRow | Exception:
        try:
            return TimedRow(self.loader.method(cell), self.loader.clip(cell), cell.spp)
        except Exception as error:  # missing weights, packages or files: the result of this row
            return error


def _groups(cells: Iterable[Cell]) -> list[Group]:
    """Cells that are timed together: rows of one size and budget where not all fit.

    Clips whose samples are traced live have groups of their own, because only one scene is open.
    """

    def order(cell: Cell) -> tuple[str, int, str, float]:
        header = cell.header
        return cell.clip.cost_key, header.height * header.width, header.name, cell.spp

    groups: list[list[Cell]] = []
    for cell in sorted(cells, key=order):
        last = groups[-1] if groups else []
        if not last or len(last) == MAX_ROWS or last[0].clip.cost_key != cell.clip.cost_key:
            groups.append([])
        groups[-1].append(cell)
    return [tuple(group) for group in groups]


@dataclass
class ScatterMeter:
    """Measures factors; one scene is open at a time."""

    loader: CellLoader
    _has_scene: dict[Path, bool] = field(default_factory=dict, repr=False)  # by clip folder

    @cached_property
    def _clock(self) -> SampleClock:
        """The clock of this machine, which keeps the scene open that it traced last."""
        return open_clock()

    def measure(self, cell: Cell) -> Scatter:
        """The factor of a cell's own counts; 1 with a note where its scene cannot be traced."""
        try:
            self._clock.open_scene(cell.clip.folder)  # first: counts take a while
            return Scatter(self._clock.measure_scatter(cell.clip.folder, self._counts(cell)))
        except Exception as error:  # no scene, no tracer or no sample is a reason, it stops no run
            reason = f"{type(error).__name__}: {error}"
            return Scatter(1.0, f"scattered samples cost as those of a full frame: {reason}")

    def has_scene(self, cell: Cell) -> bool:
        """True if the scene of the cell's clip is installed, as the clip was rendered from it."""
        folder = cell.clip.folder
        if folder not in self._has_scene:
            try:
                self._clock.check_scene(folder)
                self._has_scene[folder] = True
            except Exception:  # whatever building a scene may raise: `measure` gives the reason
                self._has_scene[folder] = False
        return self._has_scene[folder]

    def _counts(self, cell: Cell) -> Any:
        frames = run_clip(self.loader.method(cell), self.loader.clip(cell), cell.spp)
        *_, last = islice(frames, FRAMES)
        return last.samples.counts


def timing_rows(
    template: Row, timing: Timing, cost: Cost, published: ProfileTime | None = None
) -> list[Row]:
    """Rows of a cell's times: of the method, of a sample, of the G-buffer and of the whole frame.

    Each time NAME_ms has the ends of its interval, NAME_low_ms and NAME_high_ms. `template` has the
    mean_spp. A `published` inference time replaces the measured one, split as measured here, and
    has no interval; percentiles stay those of this device.
    """
    row = replace(template, unit="ms", direction="lower")
    parts, convention, ends, device = _charge_inference(row, timing, published)
    inference = sum(parts.values())
    sampling = row.mean_spp * cost.sample_ms * cost.scatter.factor
    factor = f"; x {cost.scatter.factor:.3g} for scattered samples" * (cost.scatter.factor != 1)
    is_unknown = math.isnan(cost.sample_ms)
    sample_note = cost.note if is_unknown or cost.note.startswith(UNCERTAIN) else ""
    note = "" if published else _uncertainty_note(timing)
    mixed = ""
    if cost.device and not _is_same_device(device, cost.device):
        mixed = f"{TWO_DEVICES} inference of {device}, samples of {cost.device}"
    source = f"{SUM}; inference on {device}; samples: {cost.convention}"
    spent = f"{cost.convention}{factor}", sample_note or cost.scatter.note
    frame = cost.gbuffer_ms + inference + sampling
    frame_ends = tuple(
        traced * (cost.gbuffer_ms + sampling) + own * inference
        for traced, own in zip(cost.interval, ends, strict=True)
    )
    is_wide = uncertainty(frame, *frame_ends) > WIDE
    reasons = [sample_note] if is_unknown else [(note or sample_note) * is_wide, mixed]
    rows = [
        *(_with_interval(row, name, ms, ends, convention, note) for name, ms in parts.items()),
        _with_interval(row, "inference", inference, ends, convention, note),
        _with_interval(row, "gbuffer", cost.gbuffer_ms, cost.interval, cost.gbuffer_convention),
        _with_interval(row, "sample", cost.sample_ms, cost.interval, cost.convention, cost.note),
        _with_interval(row, "sampling", sampling, cost.interval, *spent),
    ]
    ratios = [end / frame for end in frame_ends] if frame else (1.0, 1.0)
    rows.append(
        _with_interval(row, "frame", frame, ratios, source, "; ".join(filter(None, reasons)))
    )
    return [*chain(*rows), *_percentile_rows(row, timing), *_clock_rows(template, timing)]


def _with_interval(
    row: Row, name: str, ms: float, ends: Sequence[float], convention: str, note: str = ""
) -> Iterator[Row]:
    """The rows of a time and of the ends of its interval, which are given relative to it."""
    time, *ends_of_it = interval_columns(name)
    yield with_value(row, time, ms, convention, note)
    if math.isfinite(ms):
        for metric, word, end in zip(ends_of_it, ("low", "high"), ends, strict=True):
            yield with_value(row, metric, end * ms, END.format(word))


def failed_time_rows(template: Row, reason: str) -> list[Row]:
    """The rows of a cell whose times an error prevented."""
    row = replace(template, unit="ms", direction="lower")
    names = (*PARTS, "inference", "sampling", "frame")
    return [with_value(row, f"{name}_ms", math.nan, "not measured", reason) for name in names]


def drop_times(rows: Sequence[Row]) -> list[Row]:
    """The rows that are not times, unchanged."""
    return [row for row in rows if row.unit != "ms" and not row.metric.startswith(CLOCK_PREFIX)]


def _charge_inference(
    row: Row, timing: Timing, published: ProfileTime | None
) -> tuple[dict[str, float], str, tuple[float, float], str]:
    """The parts of inference that a row is charged, their convention, interval and device.

    The interval is relative to the sum of the parts.
    """
    parts = {name: getattr(timing, name).mean for name in PARTS}
    total = sum(parts.values())
    if published is None:
        convention = f"{timing.frames_used} of {_describe_frames(timing)}"
        ends = (timing.low / total, timing.high / total) if total else (1.0, 1.0)
        return parts, f"mean of the {convention}", ends, row.device
    shares = {name: ms / total for name, ms in parts.items()} if total else {"denoise": 1.0}
    parts = {name: published.ms * shares.get(name, 0.0) for name in PARTS}
    convention = f"{published.convention}; split into parts as measured on {row.device}"
    return parts, convention, (1.0, 1.0), published.convention.partition(",")[0]


def _is_same_device(first: str, second: str) -> bool:
    """True for names of one device, with its threads or cores after the last comma or not."""
    return first.rpartition(",")[0] == second.rpartition(",")[0] and (
        "," in first or first == second
    )


def _uncertainty_note(timing: Timing) -> str:
    """Why the interval of an inference time is wide; empty where it is narrow."""
    if uncertainty(timing.inference.mean, timing.low, timing.high) <= WIDE:
        return ""
    return f"{UNCERTAIN} {timing.disturbance or 'its frames vary'}"


def _percentile_rows(row: Row, timing: Timing) -> Iterator[Row]:
    frames = _describe_frames(timing)
    note = _uncertainty_note(timing)
    for name in PERCENTILES:
        time, is_fetch = getattr(timing, name), name == "sample_fetch"
        excluded = "; not part of frame_ms" * is_fetch
        remark = "" if is_fetch else note
        p50 = "sample_fetch_ms" if is_fetch else f"{name}_p50_ms"
        yield with_value(row, p50, time.p50, f"median of {frames}{excluded}", remark)
        yield with_value(row, f"{name}_p95_ms", time.p95, f"p95 of {frames}{excluded}", remark)


def _clock_rows(template: Row, timing: Timing) -> Iterator[Row]:
    """What the clock saw of the machine; a number that the system does not have has no row."""
    numbers = {
        "frames": (timing.frames, "timed frames that the times are of"),
        "rounds": (timing.rounds, "rounds that these frames come from"),
        "interval": (timing.half_width, "half width of the 95 % interval / median inference"),
        "processor_share": (timing.processor_share, "processor time / wall time of inference"),
        "device_share": (
            timing.device_share,
            "time of the device's clock / wall time of inference",
        ),
        "calibration": (timing.calibration_ratio, "calibration kernel / that of a quiet moment"),
        "context_switches": (timing.switches, "involuntary context switches per frame"),
        "load": (timing.load_average, "load average of one minute before the first round"),
        "threads": (timing.threads, "threads of torch"),
    }
    for name, (value, convention) in numbers.items():
        if math.isfinite(value):
            yield with_value(template, f"{CLOCK_PREFIX}{name}", float(value), convention)


def _describe_frames(timing: Timing) -> str:
    return f"{timing.frames} frames of {timing.clip} in {timing.rounds} rounds"
