"""Sentences about the rows: what was skipped and why, and remarks on what was measured."""

from __future__ import annotations

import pandas as pd

from reports.analysis.time_notes import is_about_times

__all__ = ["remarks", "skip_reasons"]


def skip_reasons(rows: pd.DataFrame) -> list[str]:
    """What was not measured and why, one sentence for each method and reason."""
    skipped = rows[rows["value"].isna()]
    lines = []
    for (method, note), group in skipped.groupby(["method", "note"], sort=True):
        scenes = ", ".join(sorted({name for name in group["scene"] if name})) or "any scene"
        budgets = ", ".join(f"{spp:g}" for spp in sorted(set(group["target_spp"].dropna())))
        metrics = ", ".join(sorted(set(group["metric"])))
        lines.append(f"{method} on {scenes} at {budgets or 'any'} spp ({metrics}): {note}")
    return lines


def remarks(rows: pd.DataFrame) -> list[str]:
    """Notes on rows with a value, each once for a method and metric; see `time_notes` for times."""
    noted = rows[rows["value"].notna() & (rows["note"] != "") & ~is_about_times(rows["note"])]
    return sorted({f"{m}, {k}: {n}" for m, k, n in noted[["method", "metric", "note"]].to_numpy()})
