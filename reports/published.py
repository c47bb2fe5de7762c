"""What the paper states in print: Table 1, cost of a sample, deviation between seeds."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import pandas as pd

from rlbench.benchmark.results import MissingRowsError


@dataclass(frozen=True)
class PublishedRow:
    """A row of the paper's Table 1, and the row of rlbench that is nearest."""

    name: str  # as the paper writes it
    row: str  # family or family/variant
    psnr_db: float
    inference_ms: float
    note: str = ""  # in what our row is another


@dataclass(frozen=True)
class Point:
    """A score at a budget: printed, or derived from sentences as `source` tells."""

    row: str
    spp: float
    psnr_db: float
    source: str
    derived: bool = True


@dataclass(frozen=True)
class Published:
    """All of `published.toml`: each number with the place in the paper where it stands."""

    title: str
    conditions: str  # size, device, renderer, protocol
    source: str  # of the table
    spp: float  # at which the table's scores are
    table: tuple[PublishedRow, ...]
    derived: tuple[Point, ...]
    sample_ms: float  # of one sample per pixel, mean of the scenes
    scene_ms: Mapping[str, float]
    deviation_db: float  # standard deviation between trainings with different seeds
    deviation_row: str
    trainings: int

    def of(self, row: str) -> PublishedRow | None:
        """What is stated of a row, or None."""
        return next((stated for stated in self.table if stated.row == row), None)

    def points(self) -> list[Point]:
        """Every score at its budget: the table's, then those that are derived."""
        printed = [Point(s.row, self.spp, s.psnr_db, self.source, False) for s in self.table]
        return [*printed, *self.derived]


@cache
def published() -> Published:
    """The paper's numbers. Raises TypeError or KeyError if the file has lost a field."""
    read = tomllib.loads((files("reports") / "published.toml").read_text(encoding="utf-8"))
    table, sampling, seeds = read["table1"], read["sampling"], read["seeds"]
    return Published(
        title=read["title"],
        conditions=read["conditions"],
        source=table["source"],
        spp=table["spp"],
        table=tuple(PublishedRow(**row) for row in table["rows"]),
        derived=tuple(Point(**point) for point in read["derived"]),
        sample_ms=sampling["mean_ms"],
        scene_ms=sampling["scene_ms"],
        deviation_db=seeds["deviation_db"],
        deviation_row=seeds["row"],
        trainings=seeds["trainings"],
    )


def lacking(table: pd.DataFrame, metric: str) -> MissingRowsError:
    """The error of a table in which no device has a row of the paper on every scene."""
    have = ", ".join(sorted(set(table["method"]))) or "nothing"
    return MissingRowsError(
        f"no row of the paper has {metric} on every scene; the results are of: {have}; "
        "rlbench run --methods all measures the paper's"
    )
