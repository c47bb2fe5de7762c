"""Sentences about the rows: what was skipped and why, and remarks on what was measured."""

from __future__ import annotations

import pandas as pd

from reports.analysis.time_notes import is_about_times

__all__ = ["remarks", "skip_reasons"]

REQUESTED = ", requested "  # in a reason, before the budget that a sentence names anyway


def skip_reasons(rows: pd.DataFrame) -> list[str]:
    """What was not measured and why, one sentence for all methods that share place and reason."""
    skipped = rows[rows["value"].isna()]
    reasons = skipped["note"].map(lambda note: note.partition(REQUESTED)[0]).rename("reason")
    methods: dict[str, list[str]] = {}
    for (method, reason), group in skipped.groupby(["method", reasons], sort=True):
        scenes = ", ".join(sorted({name for name in group["scene"] if name})) or "any scene"
        budgets = ", ".join(f"{spp:g}" for spp in sorted(set(group["target_spp"].dropna())))
        metrics = ", ".join(sorted(set(group["metric"])))
        place = f"on {scenes} at {budgets or 'any'} spp ({metrics}): {reason}"
        methods.setdefault(place, []).append(str(method))
    return [f"{', '.join(names)} {place}" for place, names in methods.items()]


def remarks(rows: pd.DataFrame) -> list[str]:
    """Notes on rows with a value, each once for a method and metric; see `time_notes` for times."""
    noted = rows[rows["value"].notna() & (rows["note"] != "") & ~is_about_times(rows["note"])]
    return sorted({f"{m}, {k}: {n}" for m, k, n in noted[["method", "metric", "note"]].to_numpy()})
