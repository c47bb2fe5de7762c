"""The results table: one number a row, one file a cell, so that a killed run loses one cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote

from rlbench.errors import RlbenchError
from rlbench.system import paths

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

WHOLE_CLIP = -1  # `frame` of a number that belongs to no single frame
SUFFIX = ".parquet"
CELL = b"cell"  # where a file says which cell it holds
LONGEST = 150  # letters of a file name; with what else it is called, file systems allow 255
AT = "@"  # between a method and what its weights are called, where those are not the shipped ones
HALF, CROSSVAL = "half", "crossval"  # such names that are not those of weights
FOLD = "without "  # before the scene that weights of a cross-validation have not seen


class TableError(RlbenchError, ValueError):
    """Rows that cannot be stored, or a folder that holds no results."""


class MissingRowsError(TableError):
    """A sound table without the rows that one report is of; `report all` goes on without it."""


@dataclass(frozen=True)
class Row:
    """One number; what could not be measured is a row with value nan and a note that says why."""

    run: str  # identifies the command that measured it
    method: str  # as on the command line: family or family/variant; of named weights NAME@WEIGHTS
    clip: str
    scene: str
    spp: float  # samples per pixel asked for
    spp_realised: float  # samples per pixel bought, or nan where nothing was
    frame: int  # 0, 1, ...; -1 for the whole clip
    metric: str  # psnr, denoise_ms, ...
    value: float  # finite, or nan with a note
    unit: str = ""  # dB, ms, ...; empty for a plain number
    better: str = ""  # "high", "low", or empty where neither is
    convention: str = ""  # how it was measured: peak, colour space, cost profile
    note: str = ""  # why there is no value, or what to know of it
    seed: int = 0
    preset: str = ""  # of the clip's frames, empty where they are somebody's own
    device: str = ""  # the machine's part that ran it, by its model name
    dtype: str = ""  # precision of the method, such as float32
    code: str = ""  # hash of the method's code
    weights: str = ""  # hash of the method's weights, empty where there are none
    config: str = "{}"  # JSON of the method's settings


COLUMNS = tuple(field.name for field in fields(Row))
GIVEN = {field.name: field.default for field in fields(Row) if field.default is not MISSING}
_KINDS = {field.name: str(field.type) for field in fields(Row)}


def write_cell(folder: Path, cell: str, rows: Sequence[Row]) -> Path:
    """The file that now holds all rows of `cell`; it appears whole or not at all.

    A cell is written once it is finished, and a second writing replaces the first. Raises
    TableError if there are no rows, or a value is infinite, or is nan without a note.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    _check(cell, rows)
    target = _file(folder, cell)
    told = _schema().with_metadata({CELL: cell})
    table = pa.Table.from_pylist([asdict(row) for row in rows], schema=told)
    with paths.replacing(target) as unfinished:
        pq.write_table(table, unfinished)
    return target


def cells(folder: Path) -> set[str]:
    """Names of the finished cells; a file that is unfinished or cut short does not count."""
    return set(_finished(folder).values())


def drop_cell(folder: Path, cell: str) -> None:
    """Remove a cell, if it is there, whatever its file is called."""
    file = _file(folder, cell)
    others = () if file.is_file() else _finished(folder).items()
    for each in (file, *(other for other, held in others if held == cell)):
        each.unlink(missing_ok=True)


def read(folder: Path) -> pd.DataFrame:
    """All cells below `folder` as one frame, in the order of `COLUMNS`, sorted by cell.

    `frame` and `seed` are int64; `spp`, `spp_realised` and `value` float64; all others strings
    that are empty rather than missing. Raises TableError, saying what was found, if there are none.
    """
    import pandas as pd
    import pyarrow.parquet as pq

    found = _finished(folder)
    if not found:
        raise TableError(f"no results in {folder}: {_described(folder)}; rlbench run writes them")
    parts = [pq.ParquetFile(file).read().to_pandas() for file in found]
    given = [part.assign(**{k: v for k, v in GIVEN.items() if k not in part}) for part in parts]
    table: pd.DataFrame = pd.concat(given, ignore_index=True)[list(COLUMNS)]
    return table


def select_methods(rows: pd.DataFrame, names: Sequence[str]) -> pd.Series[bool]:
    """Which rows are of methods in `names`; those of named weights are of their method too."""
    return rows["method"].isin(names) | rows["method"].str.partition(AT)[0].isin(names)


def to_dataframe(rows: Sequence[Row]) -> pd.DataFrame:
    """The frame that `read` would give of these rows."""
    import pyarrow as pa

    table: pd.DataFrame = pa.Table.from_pylist(
        [asdict(row) for row in rows], schema=_schema()
    ).to_pandas()
    return table


def _schema() -> pa.Schema:
    import pyarrow as pa

    kinds = {"str": pa.string(), "float": pa.float64(), "int": pa.int64()}
    return pa.schema([pa.field(name, kinds[kind]) for name, kind in _KINDS.items()])


def _check(cell: str, rows: Sequence[Row]) -> None:
    if not cell:
        raise TableError("a cell needs a name")
    if not rows:
        raise TableError(f"cell '{cell}' has no rows; a failed measurement is a row with a note")
    for row in rows:
        asked = f"cell '{cell}', {row.metric} of {row.method} on {row.clip}, frame {row.frame}"
        if math.isinf(row.value):
            raise TableError(f"{asked}: value is {row.value}; a value is finite, or nan and a note")
        if math.isnan(row.value) and not row.note:
            raise TableError(f"{asked}: value is nan and the note does not say why")


def _file(folder: Path, cell: str) -> Path:
    name = quote(cell, safe=" =,+@")  # a slash or a leading dot must not reach the file system
    name = name.replace(".", "%2E")
    if len(name) > LONGEST:  # the file itself has it in full
        name = f"{name[:LONGEST]} {sha256(cell.encode()).hexdigest()[:16]}"
    return folder / (name + SUFFIX)


def _finished(folder: Path) -> dict[Path, str]:
    """The whole files, sorted, and the cell that each holds."""
    found = {file: _held(file) for file in sorted(folder.glob(f"*{SUFFIX}"))}
    return {file: cell for file, cell in found.items() if cell is not None}


def _held(file: Path) -> str | None:
    """The cell that a whole file holds, as it says itself; None of one that is not whole."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if file.name.startswith("."):
        return None
    try:
        schema = pq.read_schema(file)
    except (pa.ArrowInvalid, OSError):
        return None
    if not set(COLUMNS) - GIVEN.keys() <= set(schema.names):
        return None
    told: bytes = (schema.metadata or {}).get(CELL, b"")
    return told.decode() or unquote(file.name.removesuffix(SUFFIX))


def _described(folder: Path) -> str:
    if not folder.is_dir():
        return "there is no such folder"
    files = sorted(file.name for file in folder.iterdir())
    more = f" and {len(files) - 4} more" if len(files) > 4 else ""
    return f"it holds {', '.join(files[:4])}{more}" if files else "the folder is empty"
