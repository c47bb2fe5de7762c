"""What is to be measured, and the name of each cell: a hash of all that its numbers depend on."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from itertools import product
from pathlib import Path

import torch

from rlbench import cost, latency, provenance, registry, table
from rlbench.source import Source
from rlbench.weights import WeightsError, read_card

SPP = (0.5, 1.0, 2.0, 4.0)  # budgets if none are asked for
FAILED = "failed"  # instead of a hash
LIMITED = "first-"  # before the hash of a cell that is of the first frames alone
MEASURE = (
    "rlbench.bench",
    "rlbench.times",
    "rlbench.latency",
    "rlbench.cost",
)  # what makes numbers of images


class CellsError(ValueError):
    """Cells that results could not tell apart."""


@dataclass(frozen=True)
class Request:
    """What is to be measured."""

    methods: tuple[str, ...]  # family or family/variant
    clips: tuple[Source, ...]
    spp: tuple[float, ...] = SPP  # samples per pixel
    seeds: tuple[int, ...] = (0,)  # of the order in which samples are sold, and of rounding
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    cost: str = cost.MEASURED  # or a profile
    weights: str | None = None  # None for the shipped ones, "random", or a path
    frames: int | None = None  # only the first frames of each clip, for trying out
    repeats: int = latency.REPEATS  # frames that each time is the distribution of
    half: bool = False  # do networks compute in bfloat16?
    called: str = ""  # name of the weights, where several of one method are to be told apart
    without: str = ""  # scene that `weights` were not trained on, in a cross-validation

    def halves(self, method: str) -> bool:
        """Does a method compute in half precision? One without networks has nothing to halve."""
        return self.half and registry.variant(method).learned


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


def distinct(request: Request) -> None:
    """Raise CellsError where two clips have one name: one of them would replace the other."""
    names = [clip.header.name for clip in request.clips]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise CellsError(
            f"{names.count(twice[0])} of the clips given are called '{twice[0]}', and results are "
            "kept by name; give them other names in clip.toml, or measure them into two folders"
        )


def by_title(stored: Iterable[str]) -> dict[str, set[str]]:
    """Stored cells by what they are; of one title there is more than one where a run was killed."""
    found: dict[str, set[str]] = {}
    for name in stored:
        found.setdefault(name.rpartition(" ")[0], set()).add(name)
    return found


def never_shortened(request: Request, name: str, stored: Mapping[str, set[str]]) -> None:
    """Raise CellsError where first frames alone would replace a whole clip's scores."""
    if request.frames is None:
        return
    for each in older(name, stored):
        title, _, content = each.rpartition(" ")
        if content != FAILED and not content.startswith(LIMITED):
            raise CellsError(
                f"'{title}' is known of the whole clip, and --limit-frames {request.frames} would "
                "replace it; give --out another folder"
            )


def older(name: str, stored: Mapping[str, set[str]]) -> set[str]:
    """The stored cells that a cell replaces: those of the same title and other content."""
    return stored.get(name.rpartition(" ")[0], set()) - {name}


@dataclass(frozen=True)
class Names:
    """Names under which the cells of a request are stored, and the hashes that they are made of."""

    request: Request

    def of(self, cell: Cell) -> str:
        """What the cell is, and after the last space a hash of its content.

        Of the first frames alone it says so, so that whole clips are not replaced by it.
        """
        pool, header = self.pools[cell.method], cell.clip.header
        charged: tuple[object, ...] = ()  # a profile knows what path samples cost, in every scene
        if self.request.cost == cost.MEASURED:
            charged = (header.sample_ms_of(pool), header.device, self.here)
        elif pool != "path":
            charged = (header.sample_ms_of(pool), header.sample_ms_of("path"), header.device)
        content = (
            *(
                cell.method,
                cell.clip.content(pool),
                cell.spp,
                cell.seed,
                self.device,
            ),
            *(self.code[cell.method], self.weights[cell.method], self.scores),
            *(self.cost, self.request.frames, self.request.repeats, torch.__version__),
            *(*charged, self.seen(cell)),
            *(self.half if self.request.halves(cell.method) else ()),
        )
        told = sha256(repr(content).encode()).hexdigest()[:16]
        return f"{self.title(cell)} {LIMITED if self.request.frames else ''}{told}"

    def title(self, cell: Cell) -> str:
        """What the cell is, without spaces at its end: at most one such cell is kept."""
        device = "-".join(self.device.split())
        told = f"{self.method(cell.method)} {cell.clip.header.name}"
        return f"{told} {cell.spp:g}spp seed{cell.seed} {device}"

    def method(self, name: str) -> str:
        """What a method is called in the results: another row for other weights or precision.

        Weights without a name are called as their file is, where shipped ones have the plain row.
        """
        called = self.request.called
        if self.request.weights and not called and self._shipped(name).is_file():
            called = _stem(self.request.weights)
        called = table.CROSSVAL if self.request.without else called
        told = "-".join(filter(None, (table.HALF if self.request.halves(name) else "", called)))
        return f"{name}{table.AT}{told}" if told and registry.variant(name).learned else name

    def seen(self, cell: Cell) -> bool:
        """Were the method's weights trained on the clip, as far as their card says?"""
        return cell.clip.header.name in self.trained_on[cell.method]

    def failed(self, cell: Cell) -> str:
        """The name of a cell that an error stopped: never that of a finished one."""
        return f"{self.title(cell)} {FAILED}"

    def settled(self) -> Names:
        """Itself, with every name known, so that it says the same on another machine."""
        _ = self.run, self.here, self.device, self.code, self.weights, self.trained_on, self.half
        return self

    @cached_property
    def run(self) -> str:
        """Hash of the whole request: the same command on the same content has the same."""
        told = " ".join(self.of(cell) for cell in cells(self.request))
        return sha256(told.encode()).hexdigest()[:12]

    @cached_property
    def device(self) -> str:
        """The device's model name."""
        return latency.device_name(self.request.device)

    @cached_property
    def here(self) -> str:
        """The machine whose path tracer samples are charged by."""
        return provenance.machine().name

    @cached_property
    def half(self) -> tuple[str, ...]:
        """What half precision adds: its own code."""
        return (provenance.code_hash(["rlbench.half"], core=()),)

    @cached_property
    def cost(self) -> str:
        """What samples are charged by: `measured`, or a profile's content."""
        known = self.request.cost == cost.MEASURED
        return cost.MEASURED if known else repr(cost.profile(self.request.cost))

    @cached_property
    def scores(self) -> str:
        """Hash of the metrics, their names and their code, and of the code that asks for them."""
        known = registry.entries("metrics")
        modules = [provenance.closure(e.target.partition(":")[0]) for e in known.values()]
        told = provenance.code_hash(set().union(*modules), core=MEASURE)
        metrics = registry.metrics().values()
        brought = sorted({name for each in metrics for name in getattr(each, "packages", ())})
        return f"{list(known)} {told} {provenance.releases(brought)}"

    @cached_property
    def pools(self) -> dict[str, str]:
        """The pool that each method buys from."""
        return {name: registry.variant(name).traits.pool for name in self.request.methods}

    @cached_property
    def code(self) -> dict[str, str]:
        """Hash of each method's code, and of the core's that hands it its samples.

        Empty where the code cannot be found, as the attempt to build the method will tell.
        """
        return {name: _found(_code, registry.family(name).build) for name in self.request.methods}

    @cached_property
    def weights(self) -> dict[str, str]:
        """Hash of each method's weights, and versions of packages that bring them; or empty."""
        brought = {n: registry.variant(n).packages for n in self.request.methods}
        return {
            name: ", ".join(filter(None, (self._weights(name), provenance.releases(packages))))
            for name, packages in brought.items()
        }

    @cached_property
    def trained_on(self) -> dict[str, frozenset[str]]:
        """Names of the clips that each method's weights were trained on, as far as cards say."""
        return {name: _trained_on(self._file(name)) for name in self.request.methods}

    def _weights(self, name: str) -> str:
        file = self._file(name)
        if file is None:
            return "random" if registry.variant(name).learned else ""
        fold = f"{table.FOLD}{self.request.without} " if self.request.without else ""
        return fold + _hash(file)

    def _file(self, name: str) -> Path | None:
        """Where a method's weights are looked for; None for random ones, or if it has none."""
        asked = self.request.weights
        if not registry.variant(name).learned or asked == "random":
            return None
        return Path(asked) if asked else self._shipped(name)

    def _shipped(self, name: str) -> Path:
        """Where the weights that come with a method would be."""
        family = registry.family(name)
        beside = _found(registry.place, family.build)
        return Path(beside).parent / "cards" / family.weights(name.partition("/")[2])


def _stem(file: str) -> str:
    """What weights without a name are called: as their file, but never as rows of other kinds."""
    called = re.sub(r"[^\w+-]", "-", Path(file).stem, flags=re.ASCII)
    other = called.partition("-")[0] in (table.HALF, table.CROSSVAL)
    return f"weights-{called}" if other else called


def _code(target: str) -> str:
    """Hash of what builds a method, and of what that imports of its package and of others'."""
    module = target.partition(":")[0]
    loose = registry.loose_file(module)
    if loose is None:
        return provenance.code_hash(provenance.closure(module, _others()))
    told = provenance.code_hash(provenance.closure_of_file(loose, _others()))
    return sha256(told.encode() + loose.read_bytes()).hexdigest()[:16]


def _others() -> set[str]:
    """The top-level packages of installed methods, of which one may use another's parts."""
    return {each.target.partition(".")[0] for each in registry.entries("methods").values()}


def _hash(file: Path) -> str:
    """Hash of a file's name and content; empty where there is none."""
    if not file.is_file():
        return ""
    return sha256(file.name.encode() + b"\0" + file.read_bytes()).hexdigest()[:16]


def _trained_on(file: Path | None) -> frozenset[str]:
    """Names of the clips on the card beside a weights file; none where there is no card."""
    try:
        told = read_card(file).data if file else ()
    except WeightsError:
        return frozenset()
    return frozenset(clip.rpartition(" ")[0] or clip for clip in told)


def _found(look: Callable[[str], Path | str], target: str) -> str:
    """What `look` finds of a module, or an empty text where there is no such module."""
    try:
        return str(look(target))
    except LookupError:
        return ""
