"""What cells take in time and samples cost: each taken once, when nothing else is running here.

Where cells run one after another that is when the first of them asks. Where they run beside one
another, `take` has to come before: on this machine, for it is this machine that rows are of.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from rlbench import registry
from rlbench.benchmark import cost, latency
from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.cost import Cost, CostProfile
from rlbench.benchmark.latency import Timing
from rlbench.benchmark.run_plan import Cell
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.parallel.executor import Executor, ProgressCallback, Resources
from rlbench.system import provenance

Key = tuple[object, ...]


@dataclass(frozen=True)
class TimingCache:
    """Times and costs that are known by now."""

    ready: CellLoader
    profile: CostProfile | None  # None where samples are charged by what this machine takes
    _known: dict[Key, Timing] = field(default_factory=dict, repr=False)
    _costs: dict[tuple[str, str], Cost] = field(default_factory=dict, repr=False)

    def __call__(self, cell: Cell, tell: ProgressCallback) -> Timing:
        """Times of a cell, taken now: work for an engine."""
        return self._taken(cell, self.ready.method(cell), self.ready.clip(cell))

    def measure_all(
        self,
        todo: Iterable[Cell],
        engine: Executor,
        share: Resources,
        timed: Callable[[Cell], None],
    ) -> list[tuple[Cell, Exception]]:
        """Take all that cells will ask for, one after another; the cells that raised an error.

        Where one did, the next one whose time would be the same is asked. `timed` hears of each
        cell that times were taken of.
        """
        able = [cell for cell in todo if not self.ready.unusable(cell)]
        errors: list[tuple[Cell, Exception]] = []
        waiting = able
        while waiting:
            firsts = {self.key(cell): cell for cell in reversed(waiting)}
            for outcome in engine.local_exclusive().map(self, list(firsts.values()), share):
                if outcome.error:
                    errors.append((outcome.job, outcome.error))
                else:
                    self._known[self.key(outcome.job)] = outcome.result()
                timed(outcome.job)
            asked = list(firsts.values())
            waiting = [c for c in waiting if self.key(c) not in self._known and c not in asked]
        for cell in able:
            self.cost(cell)
        return errors

    def key(self, cell: Cell) -> Key:
        """What a time depends on: where nothing moves nothing is warped, which takes less."""
        header = cell.clip.header
        size, moves = (header.height, header.width), header.frames > 1 and not header.static
        return cell.method, size, cell.spp, moves, header.pool_spp, cell.clip.cost_key

    def of(self, cell: Cell, method: Method, clip: Clip) -> Timing:
        """Times of a method on an open clip, taken now unless they are known."""
        key = self.key(cell)
        if key not in self._known:
            self._known[key] = self._taken(cell, method, clip)
        return self._known[key]

    def cost(self, cell: Cell) -> Cost:
        """What a sample of a cell's clip and pool costs, measured now unless it is known."""
        header, pool = cell.clip.header, registry.variant(cell.method).traits.pool
        key = (header.name, pool)
        if key not in self._costs:
            self._costs[key] = (
                cost.published(self.profile, header, pool)
                if self.profile
                else cost.measured(header, provenance.machine().name, pool)
            )
        return self._costs[key]

    def _taken(self, cell: Cell, method: Method, clip: Clip) -> Timing:
        return latency.time_method(method, clip, cell.spp, self.ready.request.repeats)
