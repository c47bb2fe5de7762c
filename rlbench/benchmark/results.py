"""The results table: one number a row, one parquet file a cell, so a killed run loses one cell.

Reports read this module alone. Files of schema 1 are read under today's names (`results_v1`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench.benchmark import results_v1
from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.row_name import RowName
from rlbench.errors import RlbenchError
from rlbench.system import documents, paths

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

__all__ = [
    "COLUMNS",
    "HELD_OUT_PREFIX",
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
    "select_methods",
    "to_dataframe",
    "write_cell",
]

SCHEMA = 2  # of columns, names and metadata
WHOLE_CLIP = -1  # `frame` of a number that belongs to no single frame
SUFFIX = ".parquet"
METADATA = b"rlbench"  # key of the JSON with the schema and the cell's identity
HELD_OUT_PREFIX = "without "  # in `weights_hash`, before the scene that a cross-validation held out


class TableError(RlbenchError, ValueError):
    """Rows that cannot be stored, or a folder without results."""


class MissingRowsError(TableError):
    """A valid table without the rows that a report needs; `report all` continues without it."""


@dataclass(frozen=True)
class Row:
    """One number. A measurement that could not be made has value nan and a note with the reason."""

    run_id: str  # hash of the run plan that measured it
    method: str  # family or family/variant, with other weights or precision NAME@LABEL
    clip: str
    scene: str
    target_spp: float  # requested samples per pixel
    mean_spp: float  # samples per pixel drawn on average, or nan where none were
    frame: int  # 0, 1, ...; -1 for the whole clip
    metric: str  # psnr, denoise_ms, ...
    value: float  # finite, or nan with a note
    unit: str = ""  # dB, ms, ...; empty for a plain number
    direction: str = ""  # "higher" or "lower" is better, or empty where neither is
    convention: str = ""  # how it was measured: peak, colour space, cost profile
    note: str = ""  # why there is no value, or a remark on it
    seed: int = 0
    preset: str = ""  # of the clip, empty for a clip without one
    device: str = ""  # model name of the processor that ran the method
    dtype: str = ""  # precision of the method, such as float32
    code_hash: str = ""  # of the method's code
    weights_hash: str = ""  # of the method's weights, empty where it has none
    config: str = "{}"  # the method's config as JSON


COLUMNS = tuple(field.name for field in fields(Row))
DEFAULTS = {field.name: field.default for field in fields(Row) if field.default is not MISSING}
_KINDS = {field.name: str(field.type) for field in fields(Row)}


@dataclass(frozen=True)
class _Metadata:
    """What a file says of itself in the parquet metadata."""

    schema: int
    key: CellKey
    content_hash: str


def write_cell(folder: Path, cell: CellId, rows: Sequence[Row]) -> Path:
    """Write all rows of a finished cell and return its file; the file appears whole or not at all.

    A second call with the same `cell` replaces the first. Raises TableError if there are no rows,
    or if a value is infinite, or nan without a note.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    _check(cell, rows)
    target = folder / f"{cell.file_stem}{SUFFIX}"
    metadata = json.dumps(asdict(_Metadata(SCHEMA, cell.key, cell.content_hash)))
    schema = _schema().with_metadata({METADATA: metadata})
    table = pa.Table.from_pylist([asdict(row) for row in rows], schema=schema)
    with paths.atomic_write(target) as unfinished:
        pq.write_table(table, unfinished)
    return target


def cells(folder: Path) -> set[CellId]:
    """Identities of the finished cells; an unfinished or truncated file does not count."""
    return set(_finished(folder).values())


def drop_cell(folder: Path, cell: CellId) -> None:
    """Remove a cell, if it is there, whatever its file is called."""
    file = folder / f"{cell.file_stem}{SUFFIX}"
    others = () if file.is_file() else _finished(folder).items()
    for path in (file, *(other for other, stored in others if stored == cell)):
        path.unlink(missing_ok=True)


def read(folder: Path) -> pd.DataFrame:
    """All cells in `folder` as one table, in the order of `COLUMNS`, sorted by file name.

    `frame` and `seed` are int64; `target_spp`, `mean_spp` and `value` float64; all others strings
    that are empty rather than missing. Raises TableError if there are no cells.
    """
    import pandas as pd

    files = _finished(folder)
    if not files:
        raise TableError(f"no results in {folder}: {_content(folder)}; rlbench run writes them")
    table: pd.DataFrame = pd.concat([_read_file(file) for file in files], ignore_index=True)
    return table


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
        [asdict(row) for row in rows], schema=_schema()
    ).to_pandas()
    return table


def _schema() -> pa.Schema:
    import pyarrow as pa

    kinds = {"str": pa.string(), "float": pa.float64(), "int": pa.int64()}
    return pa.schema([pa.field(name, kinds[kind]) for name, kind in _KINDS.items()])


def _check(cell: CellId, rows: Sequence[Row]) -> None:
    if not rows:
        raise TableError(f"cell '{cell.key}' has no rows; write a row with a note instead")
    for row in rows:
        where = f"cell '{cell.key}', {row.metric} of {row.method} on {row.clip}, frame {row.frame}"
        if math.isinf(row.value):
            raise TableError(f"{where}: value is {row.value}; write nan and a note instead")
        if math.isnan(row.value) and not row.note:
            raise TableError(f"{where}: value is nan and the note does not say why")


def _finished(folder: Path) -> dict[Path, CellId]:
    """The whole files, sorted, and the cell in each."""
    files = {file: _read_cell_id(file) for file in sorted(folder.glob(f"*{SUFFIX}"))}
    return {file: cell for file, cell in files.items() if cell is not None}


def _read_cell_id(file: Path) -> CellId | None:
    """The cell in a file; None if the file is unfinished, truncated or holds no results."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if file.name.startswith("."):
        return None
    try:
        schema = pq.read_schema(file)
    except (pa.ArrowInvalid, OSError):
        return None
    content = (schema.metadata or {}).get(METADATA)
    if content is None:
        old = results_v1.is_schema_1(set(schema.names))
        return results_v1.read_cell_id(file, schema) if old else None
    document: dict[str, Any] = json.loads(content)
    if document["schema"] != SCHEMA:
        raise TableError(
            f"{file} has schema {document['schema']}, this version reads 1 and {SCHEMA}. Update "
            "rlbench, or use another folder"
        )
    metadata = documents.decode(document, _Metadata)
    return CellId(metadata.key, metadata.content_hash)


def _read_file(file: Path) -> pd.DataFrame:
    import pyarrow.parquet as pq

    table: pd.DataFrame = pq.ParquetFile(file).read().to_pandas()
    if METADATA not in (pq.read_schema(file).metadata or {}):
        table = results_v1.to_current(table)
    absent = {name: value for name, value in DEFAULTS.items() if name not in table}
    return table.assign(**absent)[list(COLUMNS)]


def _content(folder: Path) -> str:
    if not folder.is_dir():
        return "there is no such folder"
    files = sorted(file.name for file in folder.iterdir())
    more = f" and {len(files) - 4} more" if len(files) > 4 else ""
    return f"it holds {', '.join(files[:4])}{more}" if files else "the folder is empty"
