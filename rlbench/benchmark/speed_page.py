"""The page of `rlbench speed`: a table per image size, and what its columns mean."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import torch

from rlbench.benchmark.latency import device_name
from rlbench.benchmark.speed import COLUMNS

__all__ = ["speed_page", "write_speed"]

SHOWN = {
    "method": "method",
    "plan_ms": "plan, ms",
    "allocate_ms": "allocate",
    "denoise_ms": "denoise",
    "inference_ms": "inference",
    "inference_p95_ms": "p95",
    "parameters": "thousand parameters",
    "multiply_adds": "thousand multiply-adds / pixel",
    "peak_share": "share of peak",
    "state_bytes": "bytes of state / pixel",
    "memory_mb": "memory, MiB",
}
DECIMALS = {"parameters": 0, "multiply_adds": 1, "state_bytes": 0, "memory_mb": 0, "peak_share": 2}


def write_speed(table: pd.DataFrame, device: torch.device, out: Path) -> list[Path]:
    """Write speed.csv and speed.md into a folder; returns both."""
    out.mkdir(parents=True, exist_ok=True)
    rows, page = out / "speed.csv", out / "speed.md"
    table.to_csv(rows, index=False)
    page.write_text(speed_page(table, device_name(device)), encoding="utf-8")
    return [rows, page]


def speed_page(table: pd.DataFrame, device: str) -> str:
    """A Markdown page with one table per size."""
    legend = "; ".join(f"*{SHOWN[name]}*: {COLUMNS[name]}" for name in list(SHOWN)[1:])
    parts = [
        "# Speed of methods",
        f"One frame at 1 spp, generated, on {device}. {legend}.",
    ]
    for (height, width), rows in table.groupby(["height", "width"], sort=False):
        parts += [f"## {width} x {height}", _table(rows), *_notes(rows)]
    return "\n\n".join(parts) + "\n"


def _table(rows: pd.DataFrame) -> str:
    lines = [_line(list(SHOWN.values())), _line(["---", *["---:"] * (len(SHOWN) - 1)])]
    for _, row in rows.iterrows():
        mark = "?" if row["note"] else ""
        numbers = [_format(name, row[name]) for name in list(SHOWN)[1:]]
        lines.append(_line([f"`{row['method']}`{mark}", *numbers]))
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _format(name: str, value: float) -> str:
    return "" if pd.isna(value) else f"{value:.{DECIMALS.get(name, 1)}f}"


def _notes(rows: pd.DataFrame) -> list[str]:
    noted = rows[rows["note"] != ""]
    return [f"? `{row['method']}`: {row['note']}" for _, row in noted.iterrows()]
