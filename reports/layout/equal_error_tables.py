"""Tables of methods at equal error: samples and time that each needs, and effective spp."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from reports.analysis.curves import Curve
from reports.analysis.equal_error import SPP_COLUMNS, TIME_COLUMNS
from reports.layout.equal_time_tables import by_column
from reports.layout.tables import Table

__all__ = ["effective_table", "error_tables", "level_table"]

Record = Mapping[Hashable, Any]

INVERTED = (
    "Brackets: where the paired 95 % interval of the difference includes zero. `<`: already at the "
    "smallest measured budget; `>`: not by the largest."
)


def error_tables(
    records: pd.DataFrame, base: Curve, sample_ms: float, curves: Mapping[str, Curve]
) -> list[Table]:
    """spp and frame time at which each method has the errors of `base`."""
    times = dict(zip(base.spp.tolist(), base.frame_ms(sample_ms).tolist(), strict=True))
    return [
        by_column(
            f"Samples to the error of {base.method}",
            f"spp at which each method has the PSNR that {base.method} has at the spp on top. "
            + INVERTED,
            records,
            "target",
            lambda spp: f"{spp:g} spp",
            lambda row: _spp_cell(row, curves[row["method"]]),
        ),
        by_column(
            f"Time to the error of {base.method}",
            f"Frame time in ms at which each method has the PSNR that {base.method} has at the "
            f"spp and in the time on top. {INVERTED}",
            records,
            "target",
            lambda spp: f"{spp:g} spp, {times[spp]:.1f} ms",
            lambda row: _time_cell(row, curves[row["method"]], sample_ms),
        ),
    ]


def level_table(records: pd.DataFrame, sample_ms: float, curves: Mapping[str, Curve]) -> Table:
    """Frame time at which each method has each round PSNR."""
    caption = (
        "Frame time in ms at which each method has the mean PSNR on top. Brackets: where the 95 % "
        "interval of the mean over scenes includes it, which is wide, since scenes differ. `<`: "
        "already at the smallest measured budget; `>`: not by the largest."
    )
    return by_column(
        "Time to a given PSNR",
        caption,
        records,
        "target",
        lambda level: f"{level:g} dB",
        lambda row: _time_cell(row, curves[row["method"]], sample_ms),
    )


def effective_table(records: pd.DataFrame, reference: Curve | None) -> Table:
    """spp of `reference` that each method is worth; without rows if there is no reference."""
    if reference is None:
        return Table("Effective spp", "", ("method",), ())
    caption = (
        f"spp at which {reference.method} has the PSNR of the method at the spp on top: how many "
        f"samples the method is worth. {INVERTED}"
    )
    return by_column(
        f"Effective spp, in samples of {reference.method}",
        caption,
        records,
        "target",
        lambda spp: f"{spp:g} spp",
        lambda row: _spp_cell(row, reference),
    )


def _spp_cell(row: Record, curve: Curve) -> str:
    positive = curve.spp[curve.spp > 0]
    ends = (f"{positive[0]:g}", f"{positive[-1]:g}")
    return _with_ends(*(_bounded(row[name], f"{row[name]:.3g}", ends) for name in SPP_COLUMNS))


def _time_cell(row: Record, curve: Curve, sample_ms: float) -> str:
    times = curve.frame_ms(sample_ms)[curve.spp > 0]
    ends = (f"{times[0]:.1f}", f"{times[-1]:.1f}")
    pairs = zip(SPP_COLUMNS, TIME_COLUMNS, strict=True)
    return _with_ends(*(_bounded(row[spp], f"{row[ms]:.1f}", ends) for spp, ms in pairs))


def _bounded(spp: float, text: str, ends: tuple[str, str]) -> str:
    """The text, or a bound where the budget lies outside of the measured ones; - if unknown."""
    if spp != spp:
        return "-"
    return f"<{ends[0]}" if spp == 0 else f">{ends[1]}" if spp == np.inf else text


def _with_ends(value: str, low: str, high: str) -> str:
    return value if low == high or "-" in (low, high) else f"{value} [{low}, {high}]"
