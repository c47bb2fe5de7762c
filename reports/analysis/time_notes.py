"""What the notes of times say: which must not be believed, and which add times of two devices."""

from __future__ import annotations

import pandas as pd

from rlbench.benchmark.results import TWO_DEVICES, UNRELIABLE

__all__ = ["device_mixes", "is_about_times", "unreliable_rows", "unreliable_times"]

REASONS = ("inference_ms", "sample_ms")  # the metrics whose notes give the reasons once


def is_about_times(notes: pd.Series[str]) -> pd.Series[bool]:
    """Mask of the notes that begin with one of the two marks."""
    return notes.str.startswith((UNRELIABLE, TWO_DEVICES))


def unreliable_rows(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of times that failed their test."""
    return rows[(rows["unit"] == "ms") & rows["note"].str.startswith(UNRELIABLE)]


def unreliable_times(rows: pd.DataFrame) -> list[str]:
    """Which times must not be believed and why, one sentence for each method and reason."""
    marked = unreliable_rows(rows)
    lines = []
    for (metric, note), group in marked[marked["metric"].isin(REASONS)].groupby(["metric", "note"]):
        methods = ", ".join(sorted(set(group["method"])))
        scenes = ", ".join(sorted(set(group["scene"])))
        budgets = ", ".join(f"{spp:g}" for spp in sorted(set(group["target_spp"])))
        reason = str(note).removeprefix(UNRELIABLE).strip()
        lines.append(f"{metric} of {methods} on {scenes} at {budgets} spp: {reason}")
    return sorted(lines)


def device_mixes(rows: pd.DataFrame) -> dict[str, list[str]]:
    """The methods whose frame times add times of two devices, by a text that names both."""
    frames = rows[(rows["metric"] == "frame_ms") & rows["note"].str.contains(TWO_DEVICES)]
    texts = frames["note"].map(lambda note: note.partition(TWO_DEVICES)[2].strip())
    return {str(text): sorted(set(part)) for text, part in frames["method"].groupby(texts)}
