"""The results table: one number a row, one parquet file a cell, so a killed run loses one cell.

Reports read this module alone. The file of a cell has its identity and a checksum, which finds
what parquet does not: a flipped bit in a number, in a name or in the identity.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import MISSING, asdict, dataclass, fields, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.looks import count_looks
from rlbench.errors import RlbenchError
from rlbench.system import documents, paths

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

UNCERTAIN = "uncertain:"  # begins the note of a time with a wide interval; the reason follows
WIDE = 0.15  # `uncertainty` from which a time is marked
FLOOR_MS = 0.05  # half width of an interval that is narrow for any time
NO_GBUFFER = "the method reads no G-buffer"  # convention of its time, which is 0
TWO_DEVICES = "two devices:"  # in the note of a frame's time that adds times of two devices
EVENT_PREFIX = "event_"  # of rows that say what happens in a clip at their frame
COUNT_PREFIX = "pixels_with_"  # of rows of a histogram: share of a clip's pixels with N samples
NOISE_CEILING = "noise_ceiling"  # metric of rows of the clip: PSNR of its noise-free image, in dB
CLOCK_PREFIX = "clock_"  # of metrics that say how a cell's times were measured
WHOLE_CLIP = -1  # `frame` of a number that belongs to no single frame
SUFFIX = ".parquet"
DAMAGED = ".damaged"  # added to the name of a row file that cannot be read
IMAGES_PREFIX = "images "  # in `code_hash`, before the hash of images that were made elsewhere
HELD_OUT_PREFIX = "without "  # in `weights_hash`, before the scene that a cross-validation held out
HALF = "half"  # label of rows whose networks ran in half precision
OTHER_BACKENDS = ("openvino", "compile", "graph", "fused")  # labels of rows that they ran
TILES = "tiles"  # label of rows whose unchanged tiles were kept from the last image
CROSSVAL = "crossval"  # label of rows whose weights were trained without the row's scene
RESERVED_LABELS = (HALF, TILES, CROSSVAL, *OTHER_BACKENDS)  # labels that no weights may have
UNFINISHED = ".unfinished"  # a file in the folder while `rlbench evaluate` writes to it
SCHEMA = 2  # of columns, names and metadata
METADATA = b"rlbench"  # key of the JSON with the schema and the cell's identity


def uncertainty(ms: float, low: float, high: float) -> float:
    """How far a time may be from its interval's ends, as a share of it; 0 where it is not known.

    >>> uncertainty(10.0, 8.0, 12.0), uncertainty(0.1, 0.06, 0.14), uncertainty(10.0, 10.0, 10.0)
    (0.25, 0.0, 0.0)
    """
    if not high - low > 2 * FLOOR_MS:  # nan too
        return 0.0
    return max(high / ms, ms / low if low > 0 else math.inf) - 1


def interval_columns(part: str) -> tuple[str, str, str]:
    """The metrics of a time, and of the ends of its interval.

    >>> interval_columns("frame")
    ('frame_ms', 'frame_low_ms', 'frame_high_ms')
    """
    return f"{part}_ms", f"{part}_low_ms", f"{part}_high_ms"


def mark_uncertainty(share: float) -> str:
    """What stands after a time whose `uncertainty` is `share`; empty where it is narrow.

    >>> mark_uncertainty(0.254), mark_uncertainty(0.1)
    (' ±25 %', '')
    """
    return f" ±{100 * share:.0f} %" if share > WIDE else ""


class TableError(RlbenchError, ValueError):
    """Rows that cannot be stored or read, or a folder without results."""


class MissingRowsError(TableError):
    """A valid table without the rows that a report needs; `report all` continues without it."""


class DamagedFileError(TableError):
    """A row file that was cut short or changed after it was written."""


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
    code_hash: str = ""  # of the method's code, or of images that were made elsewhere
    weights_hash: str = ""  # of the method's weights, empty where it has none
    config: str = "{}"  # the method's config as JSON
    size: str = ""  # of the images, WIDTHxHEIGHT pixels


COLUMNS = tuple(field.name for field in fields(Row))
DEFAULTS = {field.name: field.default for field in fields(Row) if field.default is not MISSING}


@dataclass(frozen=True)
class RowOptions:
    """What a label says: the options of `rlbench run` that measured a row."""

    backend: str = "eager"  # that ran the networks
    half: bool = False
    skip_tiles: bool = False
    weights: str = ""  # the rest: a name of weights, or crossval; empty for shipped weights


@dataclass(frozen=True)
class RowName:
    """A method and the label of its weights or precision; without a label, pretrained weights.

    >>> RowName.parse("ours/A2@seed3")
    RowName(family='ours', variant='A2', label='seed3')
    >>> str(RowName("ours", label="half"))
    'ours@half'
    """

    family: str
    variant: str = ""  # empty for the family's main variant
    label: str = ""  # backend, half, tiles and a name of weights or crossval, joined by -

    @classmethod
    def parse(cls, text: str) -> RowName:
        """The parts of a name that was printed by `str`."""
        method, _, label = text.partition("@")
        family, _, variant = method.partition("/")
        return cls(family, variant, label)

    @property
    def method_name(self) -> str:
        """The method as on the command line: `family` or `family/variant`."""
        return f"{self.family}/{self.variant}" if self.variant else self.family

    @property
    def options(self) -> RowOptions:
        """What the label says, part by part in the order in which a run writes them.

        >>> RowName.parse("ours@openvino-half-seed3").options
        RowOptions(backend='openvino', half=True, skip_tiles=False, weights='seed3')
        """
        words = self.label.split("-")

        def take(*known: str) -> str:
            return words.pop(0) if words and words[0] in known else ""

        backend, half, tiles = take(*OTHER_BACKENDS), take(HALF), take(TILES)
        return RowOptions(backend or "eager", bool(half), bool(tiles), "-".join(words))

    def __str__(self) -> str:
        """The name as it stands in the results."""
        return f"{self.method_name}@{self.label}" if self.label else self.method_name


def write_cell(folder: Path, cell: CellId, rows: Sequence[Row]) -> Path:
    """Write all rows of a finished cell and return its file; the file appears whole or not at all.

    A second call with the same `cell` replaces the first. Raises TableError if there are no rows,
    or if a value is infinite, or nan without a note.
    """
    import pyarrow.parquet as pq

    _check(cell, rows)
    file, table = folder / f"{cell.file_stem}{SUFFIX}", _to_arrow(rows)
    identity = {"schema": SCHEMA, **asdict(cell), "checksum": _checksum(cell, table)}
    table = table.replace_schema_metadata({METADATA: json.dumps(identity)})
    with paths.atomic_write(file) as unfinished:
        pq.write_table(table, unfinished)
    return file


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
            _read(file)
        except DamagedFileError:
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
        if (stored := _read(file)) is not None:
            key = replace(stored[0].key, first_frames_only=False)
            newest[key] = file, stored[1]
    rows = [table for _, table in sorted(newest.values(), key=lambda each: each[0])]
    if not rows:
        raise TableError(f"no results in {folder}: {_content(folder)} (rlbench run writes them)")
    table: pd.DataFrame = pd.concat(rows, ignore_index=True)
    table.attrs["looks"] = count_looks(folder)
    return table


def read_cell_rows(folder: Path, cell: CellId) -> list[Row]:
    """The rows of one finished cell, in the order of its file. Raises TableError."""
    stored = _read(folder / f"{cell.file_stem}{SUFFIX}")
    if stored is None:
        raise TableError(f"{folder} holds no cell '{cell.key}'; rlbench run measures it")
    columns = [str(name) for name in stored[1].columns]
    return [
        Row(**dict(zip(columns, values, strict=True)))
        for values in stored[1].itertuples(index=False, name=None)
    ]


def select_methods(rows: pd.DataFrame, names: Sequence[str]) -> pd.Series[bool]:
    """Mask of the rows of methods in `names`; rows with a label belong to their method too."""
    methods = rows["method"].map(lambda name: RowName.parse(name).method_name)
    return rows["method"].isin(names) | methods.isin(names)


def to_dataframe(rows: Sequence[Row]) -> pd.DataFrame:
    """These rows as `read` would return them.

    >>> row = Row("r", "mean", "city", "city", 1.0, 1.0, 0, "psnr", 20.0, "dB", "higher")
    >>> to_dataframe([row])[["method", "metric", "value"]].values.tolist()
    [['mean', 'psnr', 20.0]]
    """
    table: pd.DataFrame = _to_arrow(rows).to_pandas()
    return table


def _arrow_schema() -> pa.Schema:
    """The columns of the table and their types."""
    import pyarrow as pa

    kinds = {"str": pa.string(), "float": pa.float64(), "int": pa.int64()}
    return pa.schema([pa.field(each.name, kinds[str(each.type)]) for each in fields(Row)])


def _to_arrow(rows: Sequence[Row]) -> pa.Table:
    import pyarrow as pa

    return pa.Table.from_pylist([vars(row) for row in rows], schema=_arrow_schema())


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
        with suppress(DamagedFileError):
            stored[file] = _read_id(file)
    return {file: cell for file, cell in stored.items() if cell is not None}


def _content(folder: Path) -> str:
    if not folder.is_dir():
        return "there is no such folder"
    if nested := [child for child in sorted(folder.iterdir()) if _files(child)]:
        return f"did you mean {' or '.join(str(child) for child in nested[:4])}?"
    files = sorted(file.name for file in folder.iterdir())
    more = f" and {len(files) - 4} more" if len(files) > 4 else ""
    return f"it holds {', '.join(files[:4])}{more}" if files else "the folder is empty"


def _read_id(file: Path) -> CellId | None:
    """The cell in a file, whose rows are not read; None for parquet files of other content.

    Raises DamagedFileError, and TableError for a file that a newer version wrote.
    """
    with _naming_damage(file) as parquet:
        return _read_identity(file, parquet.schema_arrow)[0]


def _read(file: Path) -> tuple[CellId, pd.DataFrame] | None:
    """The cell in a file and its rows, both checked; else as `_read_id`."""
    with _naming_damage(file) as parquet:
        cell, checksum = _read_identity(file, parquet.schema_arrow)
        if cell is None:
            return None
        table = parquet.read()
        if checksum != _checksum(cell, table):
            raise ValueError("its rows do not have the checksum that was written with them")
        rows: pd.DataFrame = table.select(COLUMNS).cast(_arrow_schema()).to_pandas()
        return cell, rows


@contextmanager
def _naming_damage(file: Path) -> Iterator[Any]:
    """The parquet file; whatever goes wrong while it is decoded is a DamagedFileError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        content = file.read_bytes()
    except OSError as error:
        raise TableError(f"{file} cannot be read: {error.strerror}. Check the folder") from error
    try:
        yield pq.ParquetFile(pa.BufferReader(content))
    except TableError:
        raise
    except Exception as error:  # pyarrow raises a dozen types for damaged files
        reason = str(error).partition("\n")[0][:200] or type(error).__name__
        raise DamagedFileError(
            f"{file} is damaged: {reason}. Repeat the rlbench run that wrote it, which sets the "
            "file aside and measures its cell again; or delete it"
        ) from error


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
    return documents.decode(document, CellId), document["checksum"]


def _checksum(cell: CellId, table: pa.Table) -> str:
    """Hash of a cell's identity and of every name and value in its table."""
    content = [cell.document, table.column_names, table.to_pydict()]
    return sha256(json.dumps(content).encode()).hexdigest()[:16]
