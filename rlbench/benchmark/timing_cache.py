"""Times and costs that cells share, each measured once, before the scores.

`measure_all` times the rows of all cells together, in interleaved rounds, on this machine, while
nothing else runs here. Cells are scored afterwards, in any order and on any machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from rlbench import registry
from rlbench.backends import EAGER
from rlbench.benchmark import cost, latency
from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.cost import FULL_FRAME, Cost, CostProfile, Scatter
from rlbench.benchmark.cost_profile import ProfileTime
from rlbench.benchmark.latency import TimedRow, Timing
from rlbench.benchmark.resolve import ResolvedCell
from rlbench.benchmark.scatter import ScatterMeter
from rlbench.parallel.executor import Executor, JobResult, ProgressCallback, Resources
from rlbench.system import provenance

__all__ = ["TimingCache", "TimingCallback"]

MAX_ROWS = 48  # timed in one session: the state of each is in memory

TimingKey = tuple[object, ...]
Group = tuple[ResolvedCell, ...]
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
    ) -> list[JobResult[ResolvedCell, Timing]]:
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
        return [_job_result(cell, each) for cell, each in zip(group, outcomes, strict=True)]

    def measure_all(
        self,
        cells: Iterable[ResolvedCell],
        executor: Executor,
        resources: Resources,
        on_timing: TimingCallback,
    ) -> list[tuple[ResolvedCell, Exception]]:
        """Measure all times and costs of `cells` on this machine; the cells that failed.

        Where one fails, the next cell with the same time is measured. `on_timing` is called
        whenever a row has its time.
        """
        runnable = [cell for cell in cells if not self.loader.incompatibility(cell)]
        errors: list[tuple[ResolvedCell, Exception]] = []
        waiting = runnable
        while waiting:
            firsts = list({self.key(cell): cell for cell in reversed(waiting)}.values())
            for outcome in self._time(firsts, executor, resources, on_timing):
                if outcome.error:
                    errors.append((outcome.job, outcome.error))
                else:
                    self._timings[self.key(outcome.job)] = outcome.result()
            waiting = [
                cell
                for cell in waiting
                if self.key(cell) not in self._timings and cell not in firsts
            ]
        self._measure_costs([cell for cell in runnable if self.key(cell) in self._timings])
        return errors

    def key(self, cell: ResolvedCell) -> TimingKey:
        """What a time depends on. Static clips are faster, because nothing is reprojected.

        Where unchanged tiles are kept, the time depends on the clip.
        """
        header = cell.header
        size, is_moving = (header.height, header.width), header.frames > 1 and not header.static
        fetched = header.pool_spp, cell.clip.cost_key
        content = header.name if cell.method.skip_tiles else ""
        return cell.method.name, size, cell.target_spp, is_moving, *fetched, content

    def timing(self, cell: ResolvedCell) -> Timing:
        """Times of a cell that `measure_all` has measured."""
        return self._timings[self.key(cell)]

    def published_inference(self, cell: ResolvedCell) -> ProfileTime | None:
        """Inference time of a cell by the profile; None where it has none of this row."""
        method = cell.method
        is_published = method.backend == EAGER and not (method.bf16 or method.skip_tiles)
        if self.profile is None or not is_published:
            return None
        return self.profile.inference(method.name, cell.header.height, cell.header.width)

    def cost(self, cell: ResolvedCell) -> Cost:
        """Cost of a cell's samples and G-buffer, with the factor of its scattered samples."""
        header, pool, has_inputs = cell.header, cell.traits.pool, bool(cell.traits.inputs)
        key = (header.name, pool, has_inputs)
        if key not in self._costs:
            price = self._sample_cost(cell, pool)
            if has_inputs:
                path = price if pool == "path" else self._sample_cost(cell, "path")
                price = cost.with_gbuffer(price, path.sample_ms, header)
            self._costs[key] = price
        shared, own = self._scatter_keys(cell)
        scatter = self._scatters.get(own) or self._scatters.get(shared, FULL_FRAME)
        return replace(self._costs[key], scatter=scatter)

    def _measure_costs(self, cells: Sequence[ResolvedCell]) -> None:
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

    def _measure_scatter(self, cell: ResolvedCell, meter: ScatterMeter) -> None:
        shared, own = self._scatter_keys(cell)
        is_shared = shared in self._scatters and meter.has_scene(cell)
        if not is_shared and own not in self._scatters:
            measured = meter.measure(cell)
            self._scatters[own if measured.note else shared] = measured

    def _scatter_keys(self, cell: ResolvedCell) -> tuple[TimingKey, TimingKey]:
        """The key of a factor, and that of the note of a clip that has none."""
        shared = self.key(cell)
        return shared, (*shared, cell.header.name)

    def _sample_cost(self, cell: ResolvedCell, pool: str) -> Cost:
        if self.profile:
            return cost.published(self.profile, cell.header, pool)
        return cost.measured(cell.header, provenance.machine().name, pool)

    def _time(
        self,
        cells: Sequence[ResolvedCell],
        executor: Executor,
        resources: Resources,
        on_timing: TimingCallback,
    ) -> Iterator[JobResult[ResolvedCell, Timing]]:
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

    def _load(self, cell: ResolvedCell) -> TimedRow | Exception:
        try:
            return TimedRow(self.loader.method(cell), self.loader.clip(cell), cell.target_spp)
        except Exception as error:  # missing weights, packages or files: the result of this row
            return error


def _groups(cells: Iterable[ResolvedCell]) -> list[Group]:
    """Cells that are timed together: rows of one size and budget where not all fit.

    Clips whose samples are traced live have groups of their own, because only one scene is open.
    """

    def order(cell: ResolvedCell) -> tuple[str, int, str, float]:
        header = cell.header
        return cell.clip.cost_key, header.height * header.width, header.name, cell.target_spp

    groups: list[list[ResolvedCell]] = []
    for cell in sorted(cells, key=order):
        last = groups[-1] if groups else []
        if not last or len(last) == MAX_ROWS or last[0].clip.cost_key != cell.clip.cost_key:
            groups.append([])
        groups[-1].append(cell)
    return [tuple(group) for group in groups]


def _job_result(cell: ResolvedCell, outcome: Timing | Exception) -> JobResult[ResolvedCell, Timing]:
    if isinstance(outcome, Exception):
        return JobResult(cell, error=outcome)
    return JobResult(cell, outcome)
