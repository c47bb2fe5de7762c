"""What samples at adaptive counts cost more than those of a full frame, measured on a clip's scene.

Adaptive counts leave holes, so neighbouring paths are less alike and take longer. The counts are
those that a method draws on the clip.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.cost import Scatter
from rlbench.benchmark.resolve import ResolvedCell
from rlbench.render.jobs.live_pool import open_wavefronts, scene_of_folder
from rlbench.run import run_clip

__all__ = ["ScatterMeter"]

FRAMES = 3  # of the clip, so that a temporal method has a history; the last one's counts are traced


@dataclass
class ScatterMeter:
    """Measures factors; one scene is open at a time."""

    loader: CellLoader
    _has_scene: dict[Path, bool] = field(default_factory=dict, repr=False)  # by clip folder
    _open: tuple[Path, Any] | None = field(default=None, repr=False)

    def measure(self, cell: ResolvedCell) -> Scatter:
        """The factor of a cell's own counts; 1 with a note where its scene cannot be traced."""
        try:
            tracer = self._tracer(cell)
            counts = self._counts(cell)
            from rlbench.render.jobs.live_pool import scatter_factor

            return Scatter(scatter_factor(tracer, counts))
        except Exception as error:  # no scene, no tracer or no sample is a reason, it stops no run
            reason = f"{type(error).__name__}: {error}"
            return Scatter(1.0, f"scattered samples cost as those of a full frame: {reason}")

    def has_scene(self, cell: ResolvedCell) -> bool:
        """Is the scene of the cell's clip installed, as the clip was rendered from it?"""
        folder = cell.clip.folder
        if folder not in self._has_scene:
            try:
                scene_of_folder(folder)
                self._has_scene[folder] = True
            except Exception:  # whatever building a scene may raise: `measure` gives the reason
                self._has_scene[folder] = False
        return self._has_scene[folder]

    def _counts(self, cell: ResolvedCell) -> Any:
        frames = run_clip(self.loader.method(cell), self.loader.clip(cell), cell.target_spp)
        *_, last = islice(frames, FRAMES)
        return last.samples.counts

    def _tracer(self, cell: ResolvedCell) -> Any:
        """The tracer of a cell's clip. Raises ClipError where the scene is not here."""
        folder = cell.clip.folder
        if self._open is None or self._open[0] != folder:
            self._open = None  # closes the scene before the next one is opened
            self._open = folder, open_wavefronts(folder)
        return self._open[1]
