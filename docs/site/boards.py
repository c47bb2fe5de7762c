"""What a leaderboard shows: the scores of one preset, at one size, on one device."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pandas as pd

from reports.analysis.differences import ALL_SCENES, VERDICT_NOTE
from reports.analysis.scores import Scores, scores_by_device
from rlbench.apps.view.viewer.data import provenance, table_data
from rlbench.benchmark.results import WIDE

Key = tuple[str, str, float]  # method, scene, budget
OWN_CLIPS = "own clips"  # of no preset


@dataclass(frozen=True, eq=False)
class Board:
    """PSNR and times of one preset at one size on one device, and what is computed of them."""

    preset: str
    size: str  # WIDTHxHEIGHT, empty if the results have none
    scores: Scores
    source: str  # where the numbers come from: a sentence in Markdown
    stated_errors: Mapping[Key, float] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Preset, size and device: `real, 640x360, NVIDIA H100`."""
        return ", ".join(filter(None, (self.preset or OWN_CLIPS, self.size, self.scores.device)))

    @property
    def name(self) -> str:
        """The title as the name of a file: `real-640x360-nvidia-h100`."""
        return re.sub("[^a-z0-9]+", "-", self.title.lower()).strip("-")

    @cached_property
    def data(self) -> dict[str, Any]:
        """What the table of the viewer reads: every metric, ranked by scene and budget."""
        rows, device = self.scores.rows, self.scores.device
        return {
            "devices": [{"name": device, "table": table_data(rows, device)}],
            "provenance": provenance(rows),
            "verdict_note": VERDICT_NOTE,
            "wide": WIDE,
            "maps": {},
        }

    @cached_property
    def records(self) -> dict[Key, dict[str, Any]]:
        """The ranking by PSNR, over all scenes and on each."""
        metrics = self.data["devices"][0]["table"]["metrics"]
        records = [r for each in metrics if each["metric"] == "psnr" for r in each["records"]]
        return {(r["method"], r["scene"], r["target_spp"]): r for r in records}

    @cached_property
    def methods(self) -> list[str]:
        """The rows that have a score, sorted."""
        return sorted({method for method, _, _ in self.records})

    @cached_property
    def scenes(self) -> list[str]:
        """The scenes that have a score, sorted."""
        return sorted({scene for _, scene, _ in self.records} - {ALL_SCENES})

    @cached_property
    def budgets(self) -> list[float]:
        """The budgets that have a score, from the smallest."""
        return sorted({spp for _, _, spp in self.records})

    def record(self, method: str, spp: float, scene: str = "") -> dict[str, Any] | None:
        """The ranking record of a method at a budget, over all scenes or on one."""
        return self.records.get((method, scene or self._whole, spp))

    def ranking(self, spp: float, scene: str = "") -> list[str]:
        """The rows that have a score at a budget, over all scenes or on one, best first."""
        found = {method: self.record(method, spp, scene) for method in self.methods}
        means = {method: -record["mean"] for method, record in found.items() if record}
        return sorted(means, key=means.__getitem__)

    def rank(self, method: str, spp: float) -> tuple[int, int]:
        """The place of a method at a budget, from 1, and the number of rows that it is among."""
        means = [self.records[each, self._whole, spp]["mean"] for each in self.ranking(spp)]
        return 1 + means.index(self.records[method, self._whole, spp]["mean"]), len(means)

    def best_first(self, scene: str = "") -> list[str]:
        """All rows, best first at the largest budget that a row has."""
        ranked = [method for spp in reversed(self.budgets) for method in self.ranking(spp, scene)]
        return list(dict.fromkeys(ranked))

    def error(self, method: str, spp: float, scene: str) -> float:
        """Standard error of the mean over the frames of a scene in dB; nan if it is not known."""
        key = (method, scene, spp)
        return self.stated_errors.get(key, self._errors.get(key, math.nan))

    def timed(self, method: str) -> dict[str, Any] | None:
        """The record at the budget nearest to 1 spp that has a time; None without one."""
        for spp in sorted(self.budgets, key=lambda spp: abs(math.log2(spp or 1e-9))):
            record = self.record(method, spp)
            if record and not math.isnan(record["inference_ms"]):
                return record
        return None

    @property
    def _whole(self) -> str:
        """The scope of a mean over all scenes; with one scene, that scene."""
        return ALL_SCENES if len(self.scenes) > 1 else self.scenes[0]

    @cached_property
    def _errors(self) -> dict[Any, float]:
        groups = self.scores.measured.groupby(["method", "scene", "target_spp"])["value"]
        errors: dict[Any, float] = groups.sem().to_dict()
        return errors


def make_boards(
    results: pd.DataFrame, source: str, errors: Mapping[Key, float] | None = None
) -> list[Board]:
    """A board for each preset, size and device that has a PSNR, by title.

    `errors` are standard errors in dB that the rows cannot give, because they hold means. Clips of
    no preset are one board, whatever their sizes. Raises ReportError for rows that cannot be
    compared.
    """
    sizes = results["size"].where(results["preset"] != "", "")
    boards = [
        Board(str(preset), str(size), scores, source, errors or {})
        for (preset, size), rows in results.groupby(["preset", sizes])
        for scores in scores_by_device(rows)
        if len(scores.measured)
    ]
    return sorted(boards, key=lambda board: board.title)
