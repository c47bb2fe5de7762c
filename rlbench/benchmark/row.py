"""One row of the results table: one number, with what it is of and how it was measured."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from typing import TYPE_CHECKING

from rlbench.errors import RlbenchError

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = [
    "CLOCK_PREFIX",
    "COLUMNS",
    "COUNT_PREFIX",
    "DEFAULTS",
    "EVENT_PREFIX",
    "NOISE_CEILING",
    "TWO_DEVICES",
    "UNRELIABLE",
    "Row",
    "TableError",
    "arrow_schema",
]

UNRELIABLE = "unreliable:"  # begins the note of a time that failed its test; the reason follows
TWO_DEVICES = "two devices:"  # in the note of a frame's time that adds times of two devices
EVENT_PREFIX = "event_"  # of rows that say what happens in a clip at their frame
COUNT_PREFIX = "pixels_with_"  # of rows of a histogram: share of a clip's pixels with N samples
NOISE_CEILING = "noise_ceiling"  # metric of rows of the clip: PSNR of its noise-free image, in dB
CLOCK_PREFIX = "clock_"  # of metrics that say how a cell's times were measured


class TableError(RlbenchError, ValueError):
    """Rows that cannot be stored or read, or a folder without results."""


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
    size: str = ""  # of the images, WIDTHxHEIGHT pixels


COLUMNS = tuple(field.name for field in fields(Row))
DEFAULTS = {field.name: field.default for field in fields(Row) if field.default is not MISSING}
_KINDS = {field.name: str(field.type) for field in fields(Row)}


def arrow_schema() -> pa.Schema:
    """The columns of the table and their types."""
    import pyarrow as pa

    kinds = {"str": pa.string(), "float": pa.float64(), "int": pa.int64()}
    return pa.schema([pa.field(name, kinds[kind]) for name, kind in _KINDS.items()])
