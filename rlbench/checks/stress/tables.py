"""The results of a stress run as files: a CSV for tables and a JSON for scripts."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import msgspec

from rlbench.checks.result import Verdict
from rlbench.checks.stress.result import StressResult
from rlbench.system import paths, provenance

__all__ = ["VERDICT_NAMES", "write_tables"]

VERDICT_NAMES = {
    Verdict.PASSED: "passed",
    Verdict.WARNING: "degraded",
    Verdict.FAILED: "failed",
    Verdict.SKIPPED: "skipped",
}


def write_tables(
    results: Sequence[StressResult], folder: Path, is_quick: bool, device: str
) -> tuple[Path, Path]:
    """Write `stress.csv` and `stress.json`, one row a result; returns both files.

    A figure that is nan or infinite is empty or `inf` in the CSV and null in the JSON.
    """
    table, document = folder / "stress.csv", folder / "stress.json"
    rows = list(map(_row, results))
    with (
        paths.atomic_write(table) as unfinished,
        unfinished.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, [field.name for field in fields(StressResult)])
        writer.writeheader()
        writer.writerows(map(_without_nan, rows))
    content = {"quick": is_quick, "device": device, "versions": provenance.versions()}
    with paths.atomic_write(document) as unfinished:
        encoded = msgspec.json.encode({**content, "results": rows})
        unfinished.write_bytes(msgspec.json.format(encoded, indent=1) + b"\n")
    return table, document


def _row(result: StressResult) -> dict[str, Any]:
    return {**asdict(result), "verdict": VERDICT_NAMES[result.verdict]}


def _without_nan(row: dict[str, Any]) -> dict[str, Any]:
    return {name: "" if value != value else value for name, value in row.items()}
