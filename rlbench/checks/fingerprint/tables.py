"""The table of a fingerprint: printed, and written as CSV and JSON."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

import msgspec
from rich.table import Table

from rlbench.checks.fingerprint.measure import EDITS, Loss
from rlbench.system.paths import atomic_write

__all__ = ["mean_losses", "to_rich_table", "write_losses"]


def mean_losses(losses: Sequence[Loss]) -> dict[str, dict[str, float]]:
    """dB lost, mean over clips: by buffer and edit; the buffer that is worth most comes first.

    >>> costs = {"clip": "hall", "spp": 1.0, "psnr_db": 30.0, "edit": "dropped"}
    >>> lost_db = {"depth": 1.0, "albedo": 4.0}
    >>> losses = [Loss("ours", buffer=b, lost_db=lost, **costs) for b, lost in lost_db.items()]
    >>> list(mean_losses(losses))
    ['albedo', 'depth']
    """
    means: dict[str, dict[str, float]] = {}
    for buffer in dict.fromkeys(loss.buffer for loss in losses):
        means[buffer] = {}
        for edit in dict.fromkeys(loss.edit for loss in losses):
            values = [each.lost_db for each in losses if (each.buffer, each.edit) == (buffer, edit)]
            means[buffer][edit] = sum(values) / len(values)
    return dict(sorted(means.items(), key=lambda item: -item[1].get("dropped", 0.0)))


def to_rich_table(method: str, losses: Sequence[Loss]) -> Table:
    """A row per buffer, a column per edit, dB lost."""
    clips = len({loss.clip for loss in losses})
    table = Table(title=f"{method}: dB lost, mean of {clips} clips at {losses[0].spp:g} spp")
    table.add_column("buffer")
    for edit in EDITS:
        table.add_column(edit, justify="right")
    for buffer, row in mean_losses(losses).items():
        table.add_row(buffer, *(f"{row[edit]:+.2f}" for edit in EDITS))
    return table


def write_losses(losses: Sequence[Loss], folder: Path) -> list[Path]:
    """Write fingerprint.csv and fingerprint.json, a row per method, clip, buffer and edit."""
    rows = [asdict(loss) for loss in losses]
    paths = [folder / "fingerprint.csv", folder / "fingerprint.json"]
    with atomic_write(paths[0]) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Loss)])
        writer.writeheader()
        writer.writerows(rows)
    with atomic_write(paths[1]) as temporary:
        temporary.write_bytes(msgspec.json.format(msgspec.json.encode(rows), indent=1))
    return paths
