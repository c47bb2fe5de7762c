"""The file of one cell: its rows in parquet, its identity, and a checksum of both.

The checksum finds what parquet does not: a flipped bit in a number, in a name or in the identity.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.row import COLUMNS, Row, TableError, arrow_schema
from rlbench.system import documents, paths

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

__all__ = ["DamagedFileError", "read_cell", "read_id", "write"]

SCHEMA = 2  # of columns, names and metadata
METADATA = b"rlbench"  # key of the JSON with the schema and the cell's identity


class DamagedFileError(TableError):
    """A row file that was cut short or changed after it was written."""


@dataclass(frozen=True)
class _Metadata:
    """What a file says of itself in the parquet metadata."""

    schema: int
    key: CellKey
    content_hash: str
    times_hash: str
    checksum: str  # of rows and identity


def write(file: Path, cell: CellId, rows: Sequence[Row]) -> None:
    """Write the rows of a cell; the file appears complete or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_pylist([vars(row) for row in rows], schema=arrow_schema())
    metadata = _Metadata(
        SCHEMA, cell.key, cell.content_hash, cell.times_hash, _checksum(cell, table)
    )
    table = table.replace_schema_metadata({METADATA: json.dumps(asdict(metadata))})
    with paths.atomic_write(file) as unfinished:
        pq.write_table(table, unfinished)


def read_id(file: Path) -> CellId | None:
    """The cell in a file, whose rows are not read; None for parquet files of other content.

    Raises DamagedFileError, and TableError for a file that a newer version wrote.
    """
    with _naming_damage(file) as content:
        return _read_identity(file, _open(content).schema_arrow)[0]


def read_cell(file: Path) -> tuple[CellId, pd.DataFrame] | None:
    """The cell in a file and its rows, both checked; else as `read_id`. Columns as in `COLUMNS`."""
    with _naming_damage(file) as content:
        parquet = _open(content)
        cell, checksum = _read_identity(file, parquet.schema_arrow)
        if cell is None:
            return None
        table = parquet.read()
        if checksum != _checksum(cell, table):
            raise ValueError("its rows do not have the checksum that was written with them")
        rows: pd.DataFrame = table.select(COLUMNS).cast(arrow_schema()).to_pandas()
        return cell, rows


@contextmanager
def _naming_damage(file: Path) -> Iterator[bytes]:
    """The content of a file; whatever goes wrong while it is decoded is a DamagedFileError."""
    try:
        content = file.read_bytes()
    except OSError as error:
        raise TableError(f"{file} cannot be read: {error.strerror}. Check the folder") from error
    try:
        yield content
    except TableError:
        raise
    except Exception as error:  # pyarrow raises a dozen types for damaged files
        reason = str(error).partition("\n")[0][:200] or type(error).__name__
        raise DamagedFileError(
            f"{file} is damaged: {reason}. Repeat the rlbench run that wrote it, which sets the "
            "file aside and measures its cell again; or delete it"
        ) from error


def _open(content: bytes) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    return pq.ParquetFile(pa.BufferReader(content))


def _read_identity(file: Path, schema: pa.Schema) -> tuple[CellId | None, str]:
    """The cell in a file and its checksum. Raises ValueError for a damaged identity."""
    content = (schema.metadata or {}).get(METADATA)
    if content is None and set(schema.names) >= set(COLUMNS):
        raise ValueError("it has rows of results, but not the identity of their cell")
    if content is None:
        return None, ""
    document: dict[str, Any] = json.loads(content)
    if document["schema"] != SCHEMA:
        raise TableError(
            f"{file} has schema {document['schema']}, this version reads {SCHEMA}. Update "
            "rlbench, or use another folder"
        )
    metadata = documents.decode(document, _Metadata)
    cell = CellId(metadata.key, metadata.content_hash, metadata.times_hash)
    return cell, metadata.checksum


def _checksum(cell: CellId, table: pa.Table) -> str:
    """Hash of a cell's identity and of every name and value in its table."""
    content = [cell.document, table.column_names, table.to_pydict()]
    return sha256(json.dumps(content).encode()).hexdigest()[:16]
