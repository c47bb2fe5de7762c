"""What each part of `ours` gives over what would stand in its place, per sample and per time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandas as pd

from reports.analysis.differences import (
    VERDICT_NOTE,
    correct_by_holm,
    difference_notes,
    subtract_base,
)
from reports.analysis.equal_time import at_equal_latency
from reports.analysis.scores import Scores, keep_first_frames
from reports.layout.page import Section, write_report
from reports.layout.tables import (
    UNCERTAIN_MEANING,
    Record,
    Table,
    format_difference,
    pivot,
)
from rlbench.benchmark.results import MissingRowsError, mark_uncertainty

BASE = "ours"
PARTS = {  # row: what BASE has and the row lacks, or has in its place
    "ours/by-rule": "the learned correction of the density",
    "ours/A1": "rewards, beside the surrogate gradient",
    "ours/A2": "the density, learned and by rule, against uniform samples",
    "accumulate/tuned": "the correction; a denoiser that reads last image and statistics",
    "accumulate/contrast": "these, and a denoiser that knows accumulated light",
    "accumulate/intel": "all that was trained here",
    "accumulate/fast": "the correction; two thirds of the denoiser's parameters",
    "ours/latent": "nothing: this row adds encoder and latent state",
    "oidn/tuned": "memory and density",
    "oidn-intel": "memory, density, and tuning",
}
SAMPLES, TIME, FIRST = "equal samples", "equal time", "first frame"


def write(results: pd.DataFrame, folder: Path, name: str = "parts") -> list[Path]:
    """Write the rows of `PARTS` minus `ours`, see `write_report`.

    Tables of equal time need times and the cost of a sample; without them they are left out.
    """
    chosen = results[results["method"].isin([BASE, *PARTS])]
    missing = (
        f"no device has scores of {BASE} and of one of {', '.join(PARTS)}; measure them with "
        f"rlbench run -m {BASE},{','.join(PARTS)}"
    )
    if chosen.empty:
        raise MissingRowsError(missing)
    return write_report(chosen, folder, name, f"Parts of {BASE}", _section, missing)


def _section(scores: Scores) -> Section | None:
    measured = set(scores.measured["method"])
    if BASE not in measured or len(measured) < 2:
        return None
    rows = [row for row in PARTS if row in measured]
    first_frames = replace(scores, rows=keep_first_frames(scores.measured))
    gaps = {
        SAMPLES: subtract_base(scores, BASE, rows),
        TIME: _at_equal_time(scores, rows),
        FIRST: subtract_base(first_frames, BASE, rows),
    }
    records = correct_by_holm(pd.concat([part.assign(table=k) for k, part in gaps.items()]))
    parts = {title: records[records["table"] == title] for title in gaps}
    tables = [
        _gap_table(
            "Equal samples", f"Each row minus {BASE}, PSNR in dB, all frames.", parts[SAMPLES]
        ),
        *(_time_tables(scores, parts[TIME]) if len(parts[TIME]) else ()),
        _gap_table(
            "First frame",
            f"Each row minus {BASE} at equal samples, PSNR in dB of the first frame of each clip, "
            "where a memory does not help.",
            parts[FIRST],
        ),
    ]
    lists = {
        "Differences": difference_notes(records),
        "Rows without scores": [f"{row}: {PARTS[row]}" for row in PARTS if row not in rows],
        "Not run": scores.skip_reasons,
        "Uncertain times": scores.uncertain_times if len(parts[TIME]) else [],
        "Remarks": scores.remarks,
    }
    return Section(scores.device, tables, records, lists)


def _at_equal_time(scores: Scores, rows: list[str]) -> pd.DataFrame:
    """Each row in the frame time of BASE; empty without times of BASE and of another row."""
    found = at_equal_latency(scores, [BASE, *rows], BASE)
    if found.empty:
        return found
    others = found[(found["method"] != BASE) & found["spp"].notna()]
    return others.rename(columns={"base_spp": "target_spp"})


def _gap_table(title: str, caption: str, records: pd.DataFrame) -> Table:
    order = [row for row in PARTS if row in set(records["method"])]
    first = f"row: the part of {BASE} that it lacks"
    header, rows = pivot(records, format_difference, order, first)
    lines = tuple((f"{row[0]}: {PARTS[row[0]]}", *row[1:]) for row in rows)
    caption += f" Below zero: the part of {BASE} after the colon gains."
    return Table(title, caption, header, lines, VERDICT_NOTE)


def _time_tables(scores: Scores, records: pd.DataFrame) -> tuple[Table, Table]:
    order = [row for row in PARTS if row in set(records["method"])]
    header, rows = pivot(records, _format_samples, order, "row")
    columns = ", ".join(
        f"{spp:g} spp: {ms:.1f} ms"
        for spp, ms in sorted(set(zip(records["target_spp"], records["deadline_ms"], strict=True)))
    )
    gap_table = _gap_table(
        "Equal time",
        f"Each row minus {BASE}, PSNR in dB: the row at its best budget that fits the frame time, "
        f"of {BASE} at the budget above ({columns}), between the measured "
        f"ones. Inference on {scores.device_name}; cost of a sample: "
        f"{scores.cost_source or 'not named'}.",
        records,
    )
    caption = (
        f"Samples per pixel of each row in the frame time of {BASE}. After `>=` no larger budget "
        f"was measured; -: no measured budget fits. {UNCERTAIN_MEANING}."
    )
    return gap_table, Table("Samples at equal time", caption, header, rows)


def _format_samples(record: Record) -> str:
    """The samples per pixel of a row of `at_equal_latency`."""
    mark = mark_uncertainty(record["uncertainty"])
    return f"{'>= ' * bool(record['is_bound'])}{record['spp']:.2f}{mark}"
