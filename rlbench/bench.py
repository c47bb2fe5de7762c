"""Measuring: methods x clips x budgets x seeds, one cell each, written when it is done.

A cell is known by its content: method, its code and weights, clip, budget, seed, device, cost
profile, metrics and frames. What is in the results already is not run again, so a run that was
killed goes on where it was; a cell whose content has changed replaces its older self, so that a
results folder holds one answer for each method, clip, budget, seed and device. A cell that cannot
run is one row that says why.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from functools import cached_property
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

import torch

from rlbench import cost, latency, provenance, registry, table
from rlbench.cost import Cost
from rlbench.family import Variant
from rlbench.frames import Clip
from rlbench.latency import Timing
from rlbench.method import Method
from rlbench.run import Shown, run_clip
from rlbench.source import Short, Source, unusable
from rlbench.table import WHOLE_CLIP, Row

SPP = (0.5, 1.0, 2.0, 4.0)


@dataclass(frozen=True)
class Request:
    """What is to be measured."""

    methods: tuple[str, ...]  # family or family/variant
    clips: tuple[Source, ...]
    spp: tuple[float, ...] = SPP  # samples per pixel
    seeds: tuple[int, ...] = (0,)  # of the order in which samples are sold, and of ties
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    cost: str = cost.MEASURED  # or a profile
    weights: str | None = None  # None for the shipped ones, "random", or a path
    frames: int | None = None  # only the first frames of each clip, for trying out
    repeats: int = latency.REPEATS  # frames that each time is the distribution of


@dataclass(frozen=True)
class Cell:
    """One method on one clip at one budget with one seed."""

    method: str
    clip: Source
    spp: float
    seed: int


@dataclass(frozen=True)
class Done:
    """What became of the cells."""

    measured: int  # with numbers
    known: int  # in the results already
    refused: int  # with a reason instead


def measure(
    request: Request, results: Path, tell: Callable[[Cell], None] = lambda cell: None
) -> Done:
    """Write the rows of every cell that `results` does not have; `tell` hears of each finished one.

    Raises PluginError for an unknown method and CostError for an unknown profile before anything
    is measured.
    """
    bench = _Bench(request)
    known = table.cells(results) if results.is_dir() else set()
    done = Done(0, 0, 0)
    for cell in cells(request):
        name = bench.name(cell)
        if name in known:
            done = replace(done, known=done.known + 1)
        else:
            rows = bench.rows(cell)
            table.write_cell(results, name, rows)
            refused = rows[0].note != "" and len(rows) == 1
            done = replace(
                done, measured=done.measured + (not refused), refused=done.refused + refused
            )
        _drop_older(results, name, known)
        tell(cell)
    return done


def cells(request: Request) -> list[Cell]:
    """Every cell of a request, clip by clip."""
    grid = product(request.clips, request.methods, request.spp, request.seeds)
    return [Cell(method, clip, spp, seed) for clip, method, spp, seed in grid]


class _Bench:
    """What the cells of one request share: built methods, costs, and times already taken."""

    def __init__(self, request: Request) -> None:
        self.request = request
        self.metrics = registry.metrics()
        self.variants = {name: registry.variant(name) for name in request.methods}
        self.profile = None if request.cost == cost.MEASURED else cost.profile(request.cost)
        self.device = provenance.device(request.device)
        self._built: dict[str, Method | Exception] = {}
        self._times: dict[tuple[str, int, int, float], Timing] = {}

    def name(self, cell: Cell) -> str:
        """The name under which a cell is stored: what it is, then a hash of its content."""
        header = cell.clip.header
        content = (
            cell.method,
            cell.clip.digest,
            cell.spp,
            cell.seed,
            self._code(cell.method),
            self._weights(cell.method),
            self.device,
            self.profile or cost.MEASURED,
            tuple(self.metrics),
            self.request.frames,
            self.request.repeats,
        )
        told = f"{cell.method} {header.name} {cell.spp:g}spp seed{cell.seed} {self.request.device}"
        return f"{told} {sha256(repr(content).encode()).hexdigest()[:16]}"
