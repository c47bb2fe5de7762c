"""Loading cells: each method is built once for all cells, and a clip is opened for each."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

from rlbench import registry
from rlbench.backends import use_backend
from rlbench.benchmark.clip_sources import FirstFrames
from rlbench.benchmark.resolve import ResolvedCell, ResolvedMethod
from rlbench.benchmark.run_plan import RunPlan
from rlbench.checks.returns import CheckedReturns
from rlbench.clips.compatibility import incompatibility
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.system.bfloat16 import require_native_bf16
from rlbench.wrappers import HalfPrecision, SkipTiles

__all__ = ["CellLoader"]

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class CellLoader:
    """Methods and clips of a run plan."""

    plan: RunPlan
    _methods: dict[str, Method | Exception] = field(default_factory=dict, repr=False, compare=False)

    def incompatibility(self, cell: ResolvedCell) -> str | None:
        """Why a cell cannot run, as far as its clip and traits say, or None."""
        return incompatibility(cell.header, cell.traits, cell.target_spp, cell.pool_spp)

    def method(self, cell: ResolvedCell) -> Method:
        """The cell's method. Raises what building it raised, the first time and every time."""
        name = cell.method.name
        if name not in self._methods:
            _logger.info("%s: built with weights %s", name, cell.method.weights_file or "none")
            try:
                self._methods[name] = self._build(cell.method)
            except Exception as error:  # missing weights or packages: a reason for each cell
                self._methods[name] = error
        method = self._methods[name]
        if isinstance(method, Exception):
            raise method
        return method

    def clip(self, cell: ResolvedCell, scored_buffers: frozenset[str] = frozenset()) -> Clip:
        """The cell's clip, with the frames of the plan and the data that the method can use.

        `scored_buffers` are read too, where the clip has them: for metrics, as a method receives
        only the buffers that it declares.
        """
        inputs = cell.traits.inputs | (scored_buffers & set(cell.header.buffers))
        traits = replace(cell.traits, inputs=inputs)
        clip = cell.clip.open(traits, cell.target_spp, cell.seed, self.plan.device)
        return FirstFrames(clip, self.plan.limit_frames) if self.plan.limit_frames else clip

    def _build(self, resolved: ResolvedMethod) -> Method:
        method: Method = CheckedReturns(
            registry.load_method(resolved.name, self.plan.device, self.plan.weights)
        )
        use_backend(method, resolved.backend, self.plan.device, resolved.bf16)
        if resolved.bf16:
            require_native_bf16(self.plan.device)  # also on the workers of an executor
            method = HalfPrecision(method, self.plan.device)
        return SkipTiles(method) if resolved.skip_tiles else method
