"""Cells made ready to run: methods built once for all of them, and clips opened for each."""

from __future__ import annotations

from dataclasses import dataclass, field

from rlbench import registry
from rlbench.benchmark.clip_sources import FirstFrames
from rlbench.benchmark.run_plan import Cell, RunPlan
from rlbench.clips.compatibility import incompatibility
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.wrappers import HalfPrecision


@dataclass(frozen=True)
class CellLoader:
    """Methods and clips of a request."""

    request: RunPlan
    _built: dict[str, Method | Exception] = field(default_factory=dict, repr=False, compare=False)

    def unusable(self, cell: Cell) -> str | None:
        """Why a cell cannot be run, as far as it is known before, or None."""
        return incompatibility(cell.clip.header, registry.variant(cell.method).traits, cell.spp)

    def method(self, cell: Cell) -> Method:
        """The cell's method. Raises what building it raised, be it the first time or not."""
        name = cell.method
        if name not in self._built:
            try:
                built = registry.method(name, self.request.device, self.request.weights)
            except Exception as error:  # missing weights or packages: a reason for each cell
                self._built[name] = error
            else:
                halved = self.request.runs_in_bf16(name)
                self._built[name] = HalfPrecision(built, self.request.device) if halved else built
        found = self._built[name]
        if isinstance(found, Exception):
            raise found
        return found

    def clip(self, cell: Cell) -> Clip:
        """The cell's clip, as far as it is asked for and its method can use it."""
        traits = registry.variant(cell.method).traits
        clip = cell.clip.open(traits, cell.spp, cell.seed, self.request.device)
        return FirstFrames(clip, self.request.frames) if self.request.frames else clip
