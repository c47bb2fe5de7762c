"""The verdict on a run: which cells failed, and which have images that are not finite."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rlbench.benchmark.cell_key import CellKey
from rlbench.benchmark.runner import RunSummary

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["RunVerdict", "RunWarning", "judge_run"]

NONFINITE = "nonfinite"  # metric that counts pixels with a NaN or infinite channel
MAX_NAMES = 3  # cells that a sentence names


class RunWarning(UserWarning):
    """A run whose rows lack numbers that were requested; issued by `rlbench.run`."""


@dataclass(frozen=True)
class NonFinite:
    """A cell with NaN or infinite values, counted in the frame that has most of them."""

    cell: CellKey
    frame: int
    pixels: int  # with a channel that is not finite
    of_pixels: int

    def __str__(self) -> str:
        """The cell and the number of pixels, for messages.

        >>> print(NonFinite(CellKey("nan", "city", 1.0, 0, "EPYC"), 3, 16, 36864))
        nan: 16 of 36864 pixels not finite in frame 3 of city at 1 spp, seed 0
        """
        key, total = self.cell, f" of {self.of_pixels}" * bool(self.of_pixels)
        return (
            f"{key.method}: {self.pixels}{total} pixels not finite in frame {self.frame} of "
            f"{key.clip} at {key.target_spp:g} spp, seed {key.seed}"
        )


@dataclass(frozen=True)
class RunVerdict:
    """Whether a run measured what it could. A cell that a method does not support is no failure.

    >>> print(RunVerdict((), (), has_numbers=True))
    passed: no cell failed, all images are finite
    """

    failed: tuple[CellKey, ...]  # cells that an error stopped
    nonfinite: tuple[NonFinite, ...]  # cells with an image that has NaN or infinite values
    has_numbers: bool

    @property
    def has_passed(self) -> bool:
        """Is there a number, no failed cell, and no image that is not finite?"""
        return self.has_numbers and not self.failed and not self.nonfinite

    def __str__(self) -> str:
        """The verdict in one line, with the first cells of each kind."""
        if self.has_passed:
            return "passed: no cell failed, all images are finite"
        faults = {
            "stopped by an error": self.failed,
            "with images that are not finite": [each.cell for each in self.nonfinite],
        }
        parts = [f"{_count(cells)} {what} ({_names(cells)})" for what, cells in faults.items()]
        parts = [part for part, cells in zip(parts, faults.values(), strict=True) if cells]
        return f"FAILED: {'; '.join(parts) or 'no cell has a number'}"


def judge_run(summary: RunSummary, rows: pd.DataFrame) -> RunVerdict:
    """The verdict on a run with these counts and with these rows, measured now or before."""
    bad = rows[(rows["metric"] == NONFINITE) & (rows["value"] > 0)]
    columns = ["method", "clip", "target_spp", "seed", "device"]
    worst = bad.sort_values(["value", "frame"], ascending=[False, True], kind="stable")
    worst = worst.drop_duplicates(columns).sort_index()
    counted = worst[[*columns, "frame", "value", "size"]].itertuples(index=False, name=None)
    nonfinite = tuple(
        NonFinite(CellKey(*cell), int(frame), int(pixels), _pixels(size))
        for *cell, frame, pixels, size in counted
    )
    return RunVerdict(summary.failures, nonfinite, bool(rows["value"].notna().any()))


def _pixels(size: str) -> int:
    """The number of pixels of a size such as 192x192; 0 for the empty one of older results."""
    return math.prod(map(int, size.split("x"))) if size else 0


def _count(cells: Sequence[CellKey]) -> str:
    return f"{len(cells)} cell{'s' if len(cells) > 1 else ''}"


def _names(cells: Sequence[CellKey]) -> str:
    more = f", and {len(cells) - MAX_NAMES} more" if len(cells) > MAX_NAMES else ""
    return ", ".join(map(str, cells[:MAX_NAMES])) + more
