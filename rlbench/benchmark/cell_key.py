"""Identity of a cell in the results: what was measured, and a hash of what the numbers depend on.

A results folder keeps one cell for each slot: method, clip, budget, seed and device. A cell of the
same slot with other content replaces the stored one.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from typing import Any

from rlbench.errors import RlbenchError

FAILED = "failed"  # content hash of a cell that an error stopped; equal to no other
MAX_STEM_LENGTH = 150  # characters of a file name before its digest; file systems allow 255


class CellsError(RlbenchError, ValueError):
    """Cells that the results could not keep apart."""


@dataclass(frozen=True)
class CellKey:
    """What was measured: one method on one clip at one budget with one seed on one device."""

    method: str  # name of the rows, family/variant@label
    clip: str
    target_spp: float  # requested samples per pixel
    seed: int  # of the sample order and of rounding
    device: str  # model name
    preset: str = ""  # of the clip; empty for a clip without one
    first_frames_only: bool = False  # True if --limit-frames cut the clip short
    metric: str = ""  # of a cell that `rlbench evaluate` scored; empty for all metrics of a run

    @property
    def slot(self) -> CellKey:
        """The key without preset and length: results keep one cell for each slot."""
        return replace(self, preset="", first_frames_only=False)

    def __str__(self) -> str:
        """The key in words, for messages."""
        metric = f", {self.metric}" if self.metric else ""
        return f"{self.method} on {self.clip} at {self.target_spp:g} spp, seed {self.seed}{metric}"


@dataclass(frozen=True)
class CellId:
    """A key, a hash of all that the cell's scores depend on, and one of what its times do.

    Scores depend on code, weights and clip; times on the clock, the cost of a sample, and more.
    """

    key: CellKey
    content_hash: str
    times_hash: str = ""  # empty for a cell without times

    @property
    def is_failed(self) -> bool:
        """True if an error stopped the cell, so that it holds no numbers."""
        return self.content_hash == FAILED

    @property
    def document(self) -> dict[str, Any]:
        """The identity as JSON, without a metric or a hash of times that is empty."""
        document = asdict(self)
        if not self.key.metric:
            del document["key"]["metric"]
        if not self.times_hash:
            del document["times_hash"]
        return document

    @property
    def untimed(self) -> CellId:
        """The identity of the same scores without times."""
        return replace(self, times_hash="")

    @property
    def failed(self) -> CellId:
        """The identity of the same cell where an error stopped it: never that of a finished one."""
        return CellId(self.key, FAILED)

    def has_scores_of(self, cell: CellId) -> bool:
        """True if both have the same scores, whatever their times."""
        return (self.key, self.content_hash) == (cell.key, cell.content_hash) and not self.is_failed

    @property
    def file_stem(self) -> str:
        """A file name without suffix: readable, unique, and never parsed."""
        key = self.key
        words = f"{key.method} {key.clip} {key.target_spp:g}spp seed{key.seed} {key.metric}".strip()
        readable = re.sub(r"^\.|[^\w.+@= -]", "-", words, flags=re.ASCII)[:MAX_STEM_LENGTH]
        content = json.dumps(self.document, sort_keys=True)
        return f"{readable} {sha256(content.encode()).hexdigest()[:16]}"


def by_slot(stored: Iterable[CellId]) -> dict[CellKey, set[CellId]]:
    """Stored cells by slot. A slot has two cells where a run was killed while replacing one."""
    slots: dict[CellKey, set[CellId]] = {}
    for cell in stored:
        slots.setdefault(cell.key.slot, set()).add(cell)
    return slots


def superseded_cells(cell: CellId, slots: Mapping[CellKey, set[CellId]]) -> set[CellId]:
    """The stored cells that `cell` replaces: those of its slot with other content."""
    return slots.get(cell.key.slot, set()) - {cell}


def check_no_overwrite(cell: CellId, slots: Mapping[CellKey, set[CellId]]) -> None:
    """Raise CellsError where `cell` would replace scores that it does not measure again.

    These are scores of a clip of another preset with the same name, and scores of a whole clip
    where `cell` has only its first frames.
    """
    for stored in superseded_cells(cell, slots):
        if stored.is_failed:
            continue
        if stored.key.preset != cell.key.preset:
            old, new = (
                f"preset {preset}" if preset else "no preset"
                for preset in (stored.key.preset, cell.key.preset)
            )
            raise CellsError(
                f"results for '{cell.key}' exist for {old} and would be overwritten by {new}, "
                "because cells are keyed by clip name. Use another --out"
            )
        if cell.key.first_frames_only and not stored.key.first_frames_only:
            raise CellsError(
                f"results for '{cell.key}' exist for the whole clip and would be overwritten by "
                "its first frames (--limit-frames). Use another --out"
            )
