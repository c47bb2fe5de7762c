"""Numbers printed in the paper: its tables, cost of a sample, memory, deviation between seeds."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import pandas as pd

from rlbench.benchmark.results import MissingRowsError

__all__ = [
    "NetworkStudy",
    "NetworkTimes",
    "Published",
    "PublishedMemory",
    "PublishedPoint",
    "PublishedRow",
    "no_published_rows",
    "published",
]


@dataclass(frozen=True)
class PublishedRow:
    """A row of the paper's Table 1 and the method of rlbench that corresponds to it."""

    name: str  # as the paper writes it
    row: str  # family or family/variant
    psnr_db: float
    inference_ms: float
    note: str = ""  # how our method differs from it


@dataclass(frozen=True)
class PublishedPoint:
    """A score at a budget: printed, or derived from sentences that `source` names."""

    row: str
    spp: float
    psnr_db: float
    source: str
    derived: bool = True


@dataclass(frozen=True)
class NetworkTimes:
    """A row of the paper's study of network sizes: times of inference, and spp in its frame."""

    name: str  # as the paper writes it
    row: str
    sampler_ms: float
    encoder_ms: float
    denoiser_ms: float
    total_ms: float
    spp: float  # samples per pixel in the rest of the frame


@dataclass(frozen=True)
class NetworkStudy:
    """The paper's study of network sizes on one scene and in one frame time."""

    source: str
    frame_ms: float
    sample_ms: float
    scene: str
    rows: tuple[NetworkTimes, ...]

    def find(self, row: str) -> NetworkTimes | None:
        """The published times of the method `row`, or None."""
        return next((times for times in self.rows if times.row == row), None)


@dataclass(frozen=True)
class PublishedMemory:
    """What the paper's method keeps in memory, in channels of 4 bytes and in bytes."""

    source: str
    row: str
    size: int  # pixels, side of the square image
    state_channels: int
    sample_channels: int
    guide_channels: int
    earlier_channels: int  # of samples and guides of the methods before it
    bytes_per_pixel: int  # more than these
    megabytes: int  # likewise, of the image
    weights_megabytes: int  # upper bound
    working: str  # memory of intermediate features


@dataclass(frozen=True)
class Published:
    """All of `published.toml`: the numbers, each with its place in the paper."""

    title: str
    conditions: str  # size, device, renderer, protocol
    source: str  # of the table
    spp: float  # budget of the table's scores
    table: tuple[PublishedRow, ...]
    derived: tuple[PublishedPoint, ...]
    sample_ms: float  # of one sample per pixel, mean over the scenes
    scene_ms: Mapping[str, float]
    deviation_db: float  # standard deviation between trainings with different seeds
    deviation_row: str
    trainings: int
    network_study: NetworkStudy
    memory: PublishedMemory

    def find(self, row: str) -> PublishedRow | None:
        """The published row of the method `row`, or None."""
        return next((printed for printed in self.table if printed.row == row), None)

    def points(self) -> list[PublishedPoint]:
        """Every score at its budget: those of the table, then the derived ones."""
        printed = [
            PublishedPoint(p.row, self.spp, p.psnr_db, self.source, derived=False)
            for p in self.table
        ]
        return [*printed, *self.derived]


@cache
def published() -> Published:
    """The numbers of `published.toml`. Raises TypeError or KeyError if a field is missing."""
    document = tomllib.loads((files("reports") / "published.toml").read_text(encoding="utf-8"))
    table, sampling, seeds = document["table1"], document["sampling"], document["seeds"]
    study = document["network_study"]
    sizes = tuple(NetworkTimes(**row) for row in study.pop("rows"))
    return Published(
        title=document["title"],
        conditions=document["conditions"],
        source=table["source"],
        spp=table["spp"],
        table=tuple(PublishedRow(**row) for row in table["rows"]),
        derived=tuple(PublishedPoint(**point) for point in document["derived"]),
        sample_ms=sampling["mean_ms"],
        scene_ms=sampling["scene_ms"],
        deviation_db=seeds["deviation_db"],
        deviation_row=seeds["row"],
        trainings=seeds["trainings"],
        network_study=NetworkStudy(rows=sizes, **study),
        memory=PublishedMemory(**document["memory"]),
    )


def no_published_rows(results: pd.DataFrame, metric: str) -> MissingRowsError:
    """The error for results in which no device has a method of the paper on every scene."""
    methods = ", ".join(sorted(set(results["method"]))) or "none"
    return MissingRowsError(
        f"no method of the paper has {metric} on every scene; methods in the results: {methods}. "
        "Measure the paper's with rlbench run --methods all"
    )
