"""Numbers printed in the paper of `ours`, from `published.toml` beside the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import msgspec
import pandas as pd


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
    """The numbers of the paper. Raises msgspec.ValidationError if a field is missing."""
    file = files("methods") / "ours" / "published.toml"
    return msgspec.toml.decode(file.read_bytes(), type=Published)


def no_published_rows(results: pd.DataFrame) -> str:
    """The message for results in which no device has a method of the paper on every scene."""
    methods = ", ".join(sorted(set(results["method"]))) or "none"
    return (
        f"no method of the paper has psnr on every scene; methods in the results: {methods}. "
        "Measure the paper's with rlbench run --methods all"
    )
