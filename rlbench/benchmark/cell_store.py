"""The cells that a results folder holds: which are current, which are superseded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rlbench.benchmark import cell_images, results
from rlbench.benchmark.cell_images import CellImages
from rlbench.benchmark.cell_key import CellId, by_slot, superseded_cells
from rlbench.benchmark.results import WHOLE_CLIP, Row
from rlbench.benchmark.time_rows import drop_times

__all__ = ["CellStore"]


class CellStore:
    """The cells and images that a results folder held when the run began."""

    def __init__(self, folder: Path) -> None:
        """List the cells of `folder`; damaged row files are set aside."""
        self.folder = folder
        self.set_aside = tuple(results.set_aside_damaged(folder))
        self.cells = results.cells(folder)
        self.slots = by_slot(self.cells)
        self._image_slots = by_slot(images.cell for images in cell_images.list_images(folder))

    def find(self, cell: CellId) -> CellId | None:
        """The stored cell with the same scores, whatever its times, or None."""
        stored = self.slots.get(cell.key.slot, ())
        return next((each for each in stored if each.has_scores_of(cell)), None)

    def identify(self, cell: CellId, scores_only: bool) -> CellId:
        """The identity under which a run looks for a cell and writes it.

        With `scores_only` that of the stored cell with the same scores, so that its times stay.
        """
        return self.find(cell) or cell.untimed if scores_only else cell

    def rows(self, cell: CellId, with_images: bool = False) -> list[Row] | None:
        """The stored rows of a cell with the same scores, or None.

        None `with_images` if there are scores of frames, but not all their images.
        """
        if (stored := self.find(cell)) is None:
            return None
        rows = results.read_cell_rows(self.folder, stored)
        return None if with_images and self._lacks_images(cell, rows) else rows

    def time_rows(self, cell: CellId) -> list[Row]:
        """The times of the stored cell with the same scores; empty where there are none."""
        rows = self.rows(cell) or []
        scores = set(drop_times(rows))
        return [row for row in rows if row not in scores]

    def write(self, cell: CellId, rows: Sequence[Row], images: CellImages | None) -> int:
        """Write a finished cell, images first; returns how many older versions it replaced."""
        if images:
            cell_images.write_images(self.folder, cell, images)
        results.write_cell(self.folder, cell, rows)
        return self.drop_superseded(cell)

    def drop_superseded(self, cell: CellId) -> int:
        """Remove the older versions of a cell; a kill may have left one beside its successor.

        Images of older content are removed too, those of the same scores are kept.
        """
        superseded = superseded_cells(cell, self.slots)
        for older in superseded:
            results.drop_cell(self.folder, older)
        for older in superseded_cells(cell, self._image_slots):
            if not older.has_scores_of(cell):
                cell_images.drop_images(self.folder, older)
        return len(superseded)

    def _lacks_images(self, cell: CellId, rows: list[Row]) -> bool:
        is_scored = any(row.frame != WHOLE_CLIP for row in rows)
        return is_scored and cell_images.find_images(self.folder, cell) is None
