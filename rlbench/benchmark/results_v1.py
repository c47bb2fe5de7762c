"""Results of schema 1: read under today's column, metric and row names."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from rlbench.benchmark.cell_key import FAILED, CellId, CellKey
from rlbench.benchmark.row_name import BF16, OLD_BF16, RowName

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

__all__ = ["current_name", "is_schema_1", "read_cell_id", "to_current"]

COLUMNS = {
    "run": "run_id",
    "spp": "target_spp",
    "spp_realised": "mean_spp",
    "better": "direction",
    "code": "code_hash",
    "weights": "weights_hash",
}
METRICS = {
    "buy_ms": "sample_fetch_ms",
    "buy_p95_ms": "sample_fetch_p95_ms",
    "total_ms": "frame_ms",
}
DIRECTIONS = {"high": "higher", "low": "lower"}
REQUIRED = {"run", "method", "clip", "scene", "spp", "spp_realised", "frame", "metric", "value"}
CELL = b"cell"  # metadata key of the cell's name: its words, a space, PRESET,FIRST,HASH
FIRST = "first"  # middle part of that ending where --limit-frames cut the clip


def is_schema_1(columns: set[str]) -> bool:
    """Does a parquet file with these columns hold rows of schema 1?"""
    return columns >= REQUIRED


def to_current(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of schema 1 under today's names."""
    table = table.rename(columns=COLUMNS)
    changed = {"metric": table["metric"].replace(METRICS)}
    changed["method"] = table["method"].map(current_name)
    if "direction" in table:
        changed["direction"] = table["direction"].replace(DIRECTIONS)
    return table.assign(**changed)


def current_name(row_name: str) -> str:
    """Today's name of a row of schema 1.

    >>> current_name("ours/A2@half-seed0")
    'ours/A2@bf16-seed0'
    """
    name = RowName.parse(row_name)
    precision, dash, rest = name.label.partition("-")
    if precision != OLD_BF16:
        return row_name
    return str(RowName(name.family, name.variant, f"{BF16}{dash}{rest}"))


def read_cell_id(file: Path, schema: pa.Schema) -> CellId:
    """Identity of the cell in a file of schema 1, by its first row and the cell's name.

    Its content hash equals that of no cell of today: hashes of schema 1 covered other module names.
    A cell whose name says neither preset nor length counts as one of the whole clip.
    """
    import pyarrow.parquet as pq

    needed = ["method", "clip", "spp", "seed", "device", "preset"]
    columns = [name for name in needed if name in schema.names]
    row = pq.read_table(file, columns=columns).slice(0, 1).to_pylist()[0]
    name = (schema.metadata or {}).get(CELL, b"").decode() or unquote(file.stem)
    ending = name.rpartition(" ")[2]
    key = CellKey(
        method=current_name(row["method"]),
        clip=row["clip"],
        target_spp=row["spp"],
        seed=row.get("seed", 0),
        device=row.get("device", ""),
        preset=row.get("preset", ""),
        first_frames_only=ending.split(",")[1:2] == [FIRST],
    )
    return CellId(key, FAILED if ending == FAILED else f"schema 1: {ending}")
