"""The cells of some results that cannot be submitted, because an error stopped them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from rlbench import registry
from rlbench.benchmark.cell_key import CellKey
from rlbench.benchmark.results import RowName, cells
from rlbench.benchmark.submission.collect import CELL

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["drop_failed"]


def drop_failed(table: pd.DataFrame, results: Path) -> tuple[pd.DataFrame, dict[CellKey, str]]:
    """The rows of `table`, read from the folder `results`, of cells with a result; why others fail.

    An error stopped a cell when it was measured, or its method cannot be imported now.
    """
    stopped = {
        tuple(getattr(cell.key, name) for name in CELL) for cell in cells(results) if cell.is_failed
    }
    reasons: dict[Any, str] = {}
    for key, rows in cast("Iterator[tuple[Any, pd.DataFrame]]", iter(table.groupby(CELL))):
        if failure := registry.import_failure(RowName.parse(key[0]).method):
            reasons[key] = str(failure)
        elif key in stopped:
            reasons[key] = str(rows["note"].iloc[0])
    keys = table[CELL].itertuples(index=False, name=None)
    kept = table[[key not in reasons for key in keys]]
    return kept, {CellKey(*key): reason for key, reason in reasons.items()}
