"""Scores of one preset on one device, as the pages of the site show them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pandas as pd

from reports.analysis.differences import ALL_SCENES
from reports.analysis.scores import Scores, scores_by_device
from rlbench.apps.view.viewer.data import table_data

Key = tuple[str, str, float]  # method, scene, budget


@dataclass(frozen=True, eq=False)
class PresetScores:
    """PSNR and times of one preset on one device, and what is computed of them."""

    preset: str
    scores: Scores
    source: str  # where the numbers come from, a sentence
    stated_errors: Mapping[Key, float] = field(default_factory=dict)

    @cached_property
    def table(self) -> dict[str, Any]:
        """What the table of the viewer shows: every metric, ranked by scene and budget."""
        return table_data(self.scores.rows, self.scores.device)

    @cached_property
    def records(self) -> list[dict[str, Any]]:
        """The ranking by PSNR."""
        found = [m["records"] for m in self.table["metrics"] if m["metric"] == self.scores.metric]
        return list(found[0]) if found else []

    @cached_property
    def scenes(self) -> list[str]:
        """The scenes that have a score, sorted."""
        return sorted(set(self.scores.scene_means["scene"]))

    @cached_property
    def budgets(self) -> list[float]:
        """The budgets that have a score, from the smallest."""
        return sorted({record["target_spp"] for record in self.records})

    @cached_property
    def methods(self) -> list[str]:
        """The rows that have a score, sorted."""
        return sorted({record["method"] for record in self.records})

    @property
    def whole(self) -> str:
        """The scope of a mean over all scenes; with one scene, that scene."""
        return ALL_SCENES if len(self.scenes) > 1 else self.scenes[0]

    def record(self, method: str, spp: float, scene: str = "") -> dict[str, Any] | None:
        """The ranking record of a method at a budget, over all scenes or on one."""
        return self._by_key.get((method, scene or self.whole, spp))

    def rank(self, method: str, spp: float) -> tuple[int, int]:
        """The place of a method at a budget, from 1, and the number of rows that it is among."""
        at = (self.whole, spp)
        means = [r["mean"] for r in self.records if (r["scene"], r["target_spp"]) == at]
        own = self._by_key[method, *at]["mean"]
        return 1 + sum(mean > own for mean in means), len(means)

    def error(self, method: str, scene: str, spp: float) -> float:
        """Standard error of the mean over the frames of a scene in dB; nan if it is not known."""
        key = (method, scene, spp)
        return self.stated_errors.get(key, self._errors.get(key, math.nan))

    @cached_property
    def _by_key(self) -> dict[Key, dict[str, Any]]:
        return {(r["method"], r["scene"], r["target_spp"]): r for r in self.records}

    @cached_property
    def _errors(self) -> dict[Key, float]:
        groups = self.scores.measured.groupby(["method", "scene", "target_spp"])["value"]
        errors: dict[Any, float] = groups.sem().to_dict()
        return {(str(m), str(s), float(spp)): e for (m, s, spp), e in errors.items()}


def preset_scores(
    results: pd.DataFrame, source: str, errors: Mapping[Key, float] | None = None
) -> list[PresetScores]:
    """The scores of each preset and device that has a PSNR, by name.

    `errors` are standard errors in dB that the rows cannot give, because they hold means. Raises
    ReportError for rows that cannot be compared.
    """
    return [
        PresetScores(str(preset), scores, source, errors or {})
        for preset, rows in results.groupby("preset")
        for scores in scores_by_device(rows)
        if len(scores.measured)
    ]
