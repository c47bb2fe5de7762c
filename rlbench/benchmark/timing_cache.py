"""Times and costs that cells share, each measured once and while nothing else runs here.

If cells run one after another, the first cell that needs a time measures it. If they run in
parallel, `measure_all` has to come before them, on this machine, whose name the rows carry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from rlbench import registry
from rlbench.benchmark import cost, latency
from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.cost import Cost, CostProfile
from rlbench.benchmark.latency import Timing
from rlbench.benchmark.resolve import ResolvedCell
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.parallel.executor import Executor, ProgressCallback, Resources
from rlbench.system import provenance

__all__ = ["TimingCache"]

TimingKey = tuple[object, ...]


@dataclass(frozen=True)
class TimingCache:
    """Times of methods and costs of samples measured so far."""

    loader: CellLoader
    profile: CostProfile | None  # None: samples cost what they take on this machine
    _timings: dict[TimingKey, Timing] = field(default_factory=dict, repr=False)
    _costs: dict[tuple[str, str], Cost] = field(default_factory=dict, repr=False)

    def __call__(self, cell: ResolvedCell, on_progress: ProgressCallback) -> Timing:
        """Times of a cell, measured now: the work that `measure_all` hands to an executor."""
        with registry.exits_as_errors():
            return self._measure(cell, self.loader.method(cell), self.loader.clip(cell))

    def measure_all(
        self,
        cells: Iterable[ResolvedCell],
        executor: Executor,
        resources: Resources,
        on_timing: Callable[[ResolvedCell], None],
    ) -> list[tuple[ResolvedCell, Exception]]:
        """Measure all times and costs of `cells`, one after another; the cells that failed.

        Where one fails, the next cell with the same time is measured. `on_timing` is called with
        each cell that was measured.
        """
        runnable = [cell for cell in cells if not self.loader.incompatibility(cell)]
        errors: list[tuple[ResolvedCell, Exception]] = []
        waiting = runnable
        while waiting:
            firsts = list({self.key(cell): cell for cell in reversed(waiting)}.values())
            for outcome in executor.local_exclusive().map(self, firsts, resources):
                if outcome.error:
                    errors.append((outcome.job, outcome.error))
                else:
                    self._timings[self.key(outcome.job)] = outcome.result()
                on_timing(outcome.job)
            waiting = [
                cell
                for cell in waiting
                if self.key(cell) not in self._timings and cell not in firsts
            ]
        for cell in runnable:
            self.cost(cell)
        return errors

    def key(self, cell: ResolvedCell) -> TimingKey:
        """What a time depends on. Static clips are faster, because nothing is reprojected."""
        header = cell.header
        size, is_moving = (header.height, header.width), header.frames > 1 and not header.static
        fetched = header.pool_spp, cell.clip.cost_key
        return cell.method.name, size, cell.target_spp, is_moving, *fetched

    def timing(self, cell: ResolvedCell, method: Method, clip: Clip) -> Timing:
        """Times of a method on an open clip, measured now unless they are known."""
        key = self.key(cell)
        if key not in self._timings:
            self._timings[key] = self._measure(cell, method, clip)
        return self._timings[key]

    def cost(self, cell: ResolvedCell) -> Cost:
        """Cost of a sample of a cell's clip and pool, measured now unless it is known."""
        header, pool = cell.header, cell.traits.pool
        key = (header.name, pool)
        if key not in self._costs:
            self._costs[key] = (
                cost.published(self.profile, header, pool)
                if self.profile
                else cost.measured(header, provenance.machine().name, pool)
            )
        return self._costs[key]

    def _measure(self, cell: ResolvedCell, method: Method, clip: Clip) -> Timing:
        return latency.time_method(method, clip, cell.target_spp, self.loader.plan.repeats)
