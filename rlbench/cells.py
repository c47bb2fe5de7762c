"""What is to be measured, and what a cell of it is known by: its content, code and weights included."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from itertools import product
from pathlib import Path

import torch

from rlbench import cost, latency, provenance, registry
from rlbench.source import Source

SPP = (0.5, 1.0, 2.0, 4.0)  # budgets if none are asked for
CORE = ("run", "sampling", "frames", "source", "ops", "clips")  # what can change a number


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


def cells(request: Request) -> list[Cell]:
    """Every cell of a request, clip by clip."""
    grid = product(request.clips, request.methods, request.spp, request.seeds)
    return [Cell(method, clip, spp, seed) for clip, method, spp, seed in grid]


@dataclass(frozen=True)
class Names:
    """Names under which the cells of a request are stored, and the hashes that they are made of."""

    request: Request

    def of(self, cell: Cell) -> str:
        """What the cell is, and after the last space a hash of its content."""
        content = (
            *(cell.method, cell.clip.digest, cell.spp, cell.seed, self.device),
            *(self.code[cell.method], self.weights[cell.method], self.core),
            *(self.cost, self.request.frames, self.request.repeats),
        )
        return f"{self.title(cell)} {sha256(repr(content).encode()).hexdigest()[:16]}"

    def title(self, cell: Cell) -> str:
        """What the cell is, without spaces at its end: at most one such cell is kept."""
        device = "-".join(self.device.split())
        return f"{cell.method} {cell.clip.header.name} {cell.spp:g}spp seed{cell.seed} {device}"

    @cached_property
    def run(self) -> str:
        """Hash of the whole request: the same command on the same content has the same."""
        told = " ".join(self.of(cell) for cell in cells(self.request))
        return sha256(told.encode()).hexdigest()[:12]

    @cached_property
    def device(self) -> str:
        """The device's model name."""
        return provenance.device(self.request.device)

    @cached_property
    def cost(self) -> str:
        """What samples are charged by: `measured`, or a profile's content."""
        known = self.request.cost == cost.MEASURED
        return cost.MEASURED if known else repr(cost.profile(self.request.cost))

    @cached_property
    def core(self) -> str:
        """Hash of the code that hands out samples and scores images."""
        targets = [entry.target for entry in registry.entries("metrics").values()]
        return _hash([*_files(f"rlbench.{name}" for name in CORE), *_files(targets)])

    @cached_property
    def code(self) -> dict[str, str]:
        """Hash of each method's code."""
        families = {name: registry.family(name) for name in self.request.methods}
        return {name: _hash(_files([family.build])) for name, family in families.items()}

    @cached_property
    def weights(self) -> dict[str, str]:
        """Hash of each method's weights; empty where it has none."""
        return {name: self._weights(name) for name in self.request.methods}

    def _weights(self, name: str) -> str:
        if not registry.variant(name).learned:
            return ""
        if self.request.weights == "random":
            return "random"
        family, _, variant = name.partition("/")
        beside = _place(registry.family(name).build).parent / "cards"
        shipped = beside / f"{variant or family}.safetensors"
        file = Path(self.request.weights) if self.request.weights else shipped
        return _hash([file]) if file.is_file() else ""


def _files(targets: Iterable[str]) -> list[Path]:
    """Python files of the modules named, with all of a package and all beside a package's module."""
    found: dict[Path, None] = {}
    for target in targets:
        place = _place(target)
        module = target.partition(":")[0]
        whole = place.name == "__init__.py" or module.count(".") > 1
        found |= dict.fromkeys(sorted(place.parent.rglob("*.py")) if whole else [place])
    return list(found)


def _place(target: str) -> Path:
    spec = importlib.util.find_spec(target.partition(":")[0])
    if spec is None or not spec.origin:
        raise registry.PluginError(f"'{target}' names no module that can be found")
    return Path(spec.origin)


def _hash(files: Iterable[Path]) -> str:
    digest = sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]
