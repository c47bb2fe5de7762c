"""The results table: one number a row, one parquet file a cell, so a killed run loses one cell.

Reports read this module alone. `cell_file` reads, writes and checks the file of one cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.benchmark import cell_file
from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.looks import count_looks
from rlbench.benchmark.row import (
    CLOCK_PREFIX,
    COLUMNS,
    COUNT_PREFIX,
    EVENT_PREFIX,
    NOISE_CEILING,
    TWO_DEVICES,
    UNRELIABLE,
    Row,
    TableError,
    arrow_schema,
)
from rlbench.benchmark.row_name import RowName

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "CLOCK_PREFIX",
    "COLUMNS",
    "COUNT_PREFIX",
    "EVENT_PREFIX",
    "HELD_OUT_PREFIX",
    "NOISE_CEILING",
    "TWO_DEVICES",
    "UNRELIABLE",
    "WHOLE_CLIP",
    "CellId",
    "CellKey",
    "MissingRowsError",
    "Row",
    "RowName",
    "TableError",
    "cells",
    "drop_cell",
    "read",
    "read_cell_rows",
    "select_methods",
    "set_aside_damaged",
    "to_dataframe",
    "write_cell",
]

WHOLE_CLIP = -1  # `frame` of a number that belongs to no single frame
SUFFIX = ".parquet"
DAMAGED = ".damaged"  # added to the name of a row file that cannot be read
HELD_OUT_PREFIX = "without "  # in `weights_hash`, before the scene that a cross-validation held out


class MissingRowsError(TableError):
    """A valid table without the rows that a report needs; `report all` continues without it."""


def write_cell(folder: Path, cell: CellId, rows: Sequence[Row]) -> Path:
    """Write all rows of a finished cell and return its file; the file appears whole or not at all.

    A second call with the same `cell` replaces the first. Raises TableError if there are no rows,
    or if a value is infinite, or nan without a note.
    """
    _check(cell, rows)
    target = folder / f"{cell.file_stem}{SUFFIX}"
    cell_file.write(target, cell, rows)
    return target


def cells(folder: Path) -> set[CellId]:
    """Identities of the finished cells; an unfinished or damaged file does not count."""
    return set(_finished(folder).values())


def set_aside_damaged(folder: Path) -> list[Path]:
    """Rename each damaged row file to NAME.parquet.damaged; returns the new paths.

    Every row is read and checked. Raises TableError for a file that a newer version wrote.
    """
    renamed = []
    for file in _files(folder):
        try:
            cell_file.read_cell(file)
        except cell_file.DamagedFileError:
            renamed.append(file.rename(file.with_name(f"{file.name}{DAMAGED}")))
    return renamed


def drop_cell(folder: Path, cell: CellId) -> None:
    """Remove a cell, if it is there, whatever its file is called."""
    file = folder / f"{cell.file_stem}{SUFFIX}"
    others = () if file.is_file() else _finished(folder).items()
    for path in (file, *(other for other, stored in others if stored == cell)):
        path.unlink(missing_ok=True)


def read(folder: Path) -> pd.DataFrame:
    """All cells in `folder` as one table, in the order of `COLUMNS`, sorted by file name.

    Of a cell that has several versions, which a killed run may leave, the newest file is read.
    `frame` and `seed` are int64; `target_spp`, `mean_spp` and `value` float64; all others strings
    that are empty rather than missing. The number of runs that looked at each test preset is in
    `attrs["looks"]`. Raises TableError if there are no cells, and for a damaged file.
    """
    import pandas as pd

    newest: dict[CellKey, tuple[Path, pd.DataFrame]] = {}
    for file in sorted(_files(folder), key=lambda file: file.stat().st_mtime_ns):
        if (stored := cell_file.read_cell(file)) is not None:
            key = replace(stored[0].key, first_frames_only=False)
            newest[key] = file, stored[1]
    rows = [table for _, table in sorted(newest.values(), key=lambda each: each[0])]
    if not rows:
        raise TableError(f"no results in {folder}: {_content(folder)}; rlbench run writes them")
    table: pd.DataFrame = pd.concat(rows, ignore_index=True)
    table.attrs["looks"] = count_looks(folder)
    return table


def read_cell_rows(folder: Path, cell: CellId) -> list[Row]:
    """The rows of one finished cell, in the order of its file. Raises TableError."""
    stored = cell_file.read_cell(folder / f"{cell.file_stem}{SUFFIX}")
    if stored is None:
        raise TableError(f"{folder} holds no cell '{cell.key}'; rlbench run measures it")
    return [
        Row(**{str(key): value for key, value in row.items()})
        for row in stored[1].to_dict("records")
    ]


def select_methods(rows: pd.DataFrame, names: Sequence[str]) -> pd.Series[bool]:
    """Mask of the rows of methods in `names`; rows with a label belong to their method too."""
    methods = rows["method"].map(lambda name: RowName.parse(name).method)
    return rows["method"].isin(names) | methods.isin(names)


def to_dataframe(rows: Sequence[Row]) -> pd.DataFrame:
    """These rows as `read` would return them.

    >>> row = Row("r", "mean", "city", "city", 1.0, 1.0, 0, "psnr", 20.0, "dB", "higher")
    >>> to_dataframe([row])[["method", "metric", "value"]].values.tolist()
    [['mean', 'psnr', 20.0]]
    """
    import pyarrow as pa

    table: pd.DataFrame = pa.Table.from_pylist(
        [vars(row) for row in rows], schema=arrow_schema()
    ).to_pandas()
    return table


def _check(cell: CellId, rows: Sequence[Row]) -> None:
    if not rows:
        raise TableError(f"cell '{cell.key}' has no rows; write a row with a note instead")
    for row in rows:
        where = f"cell '{cell.key}', {row.metric} of {row.method} on {row.clip}, frame {row.frame}"
        if math.isinf(row.value):
            raise TableError(f"{where}: value is {row.value}; write nan and a note instead")
        if math.isnan(row.value) and not row.note:
            raise TableError(f"{where}: value is nan and the note does not say why")


def _files(folder: Path) -> list[Path]:
    """The finished files, sorted; that of a killed run begins with a dot."""
    return sorted(file for file in folder.glob(f"*{SUFFIX}") if not file.name.startswith("."))


def _finished(folder: Path) -> dict[Path, CellId]:
    """The readable files, sorted, and the cell in each."""
    stored = {}
    for file in _files(folder):
        with suppress(cell_file.DamagedFileError):
            stored[file] = cell_file.read_id(file)
    return {file: cell for file, cell in stored.items() if cell is not None}


def _content(folder: Path) -> str:
    if not folder.is_dir():
        return "there is no such folder"
    files = sorted(file.name for file in folder.iterdir())
    more = f" and {len(files) - 4} more" if len(files) > 4 else ""
    return f"it holds {', '.join(files[:4])}{more}" if files else "the folder is empty"
