"""The name of each cell: what it is, and a hash of all that its numbers depend on."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import torch

from rlbench import registry
from rlbench.benchmark import cost, latency, results
from rlbench.benchmark.run_plan import FAILED, Cell, RunPlan, cells, content_key
from rlbench.system import code_hash, provenance
from rlbench.weights import WeightsError, read_card

MEASURE = (
    "rlbench.benchmark.runner",
    "rlbench.benchmark.timing_cache",
    "rlbench.benchmark.latency",
    "rlbench.benchmark.cost",
)  # what makes numbers of images


@dataclass(frozen=True)
class CellIds:
    """Names under which the cells of a request are stored, and the hashes that they are made of."""

    request: RunPlan

    def cell_id(self, cell: Cell) -> str:
        """What the cell is, and after the last space its content (`cells.content`)."""
        pool, header = self.pools[cell.method], cell.clip.header
        charged: tuple[object, ...] = ()  # a profile knows what path samples cost, in every scene
        if self.request.cost == cost.MEASURED:
            charged = (header.sample_ms_of(pool), header.device, self.machine)
        elif pool != "path":
            charged = (header.sample_ms_of(pool), header.sample_ms_of("path"), header.device)
        everything = (
            *(
                cell.method,
                cell.clip.content(pool),
                cell.spp,
                cell.seed,
                self.device,
            ),
            *(self.code[cell.method], self.weights[cell.method], self.scores),
            *(self.cost, self.request.frames, self.request.repeats, torch.__version__),
            *(*charged, self.trained_on_clip(cell)),
            *(self.half if self.request.runs_in_bf16(cell.method) else ()),
        )
        told = sha256(repr(everything).encode()).hexdigest()[:16]
        return f"{self.cell_key(cell)} {content_key(header.preset, self.request.frames, told)}"

    def cell_key(self, cell: Cell) -> str:
        """What the cell is, without spaces at its end: at most one such cell is kept."""
        device = "-".join(self.device.split())
        told = f"{self.method(cell.method)} {cell.clip.header.name}"
        return f"{told} {cell.spp:g}spp seed{cell.seed} {device}"

    def method(self, name: str) -> str:
        """What a method is called in the results: another row for other weights or precision.

        Weights without a name are called as their file is, where shipped ones have the plain row.
        """
        called = self.request.weights_label
        if self.request.weights and not called and self._shipped(name).is_file():
            called = _stem(self.request.weights)
        called = results.CROSSVAL if self.request.held_out_scene else called
        told = "-".join(
            filter(None, (results.HALF if self.request.runs_in_bf16(name) else "", called))
        )
        return f"{name}{results.AT}{told}" if told and registry.variant(name).learned else name

    def trained_on_clip(self, cell: Cell) -> bool:
        """Were the method's weights trained on the clip, as far as their card says?"""
        return cell.clip.header.name in self.trained_on[cell.method]

    def failed(self, cell: Cell) -> str:
        """The name of a cell that an error stopped: never that of a finished one."""
        return f"{self.cell_key(cell)} {FAILED}"

    def resolved(self) -> CellIds:
        """Itself, with every name known, so that it says the same on another machine."""
        _ = self.run, self.machine, self.device, self.code, self.weights, self.trained_on, self.half
        return self

    @cached_property
    def run(self) -> str:
        """Hash of the whole request: the same command on the same content has the same."""
        told = " ".join(self.cell_id(cell) for cell in cells(self.request))
        return sha256(told.encode()).hexdigest()[:12]

    @cached_property
    def device(self) -> str:
        """The device's model name."""
        return latency.device_name(self.request.device)

    @cached_property
    def machine(self) -> str:
        """The machine whose path tracer samples are charged by."""
        return provenance.machine().name

    @cached_property
    def half(self) -> tuple[str, ...]:
        """What half precision adds: its own code."""
        return (code_hash.code_hash(["rlbench.wrappers"], core=()),)

    @cached_property
    def cost(self) -> str:
        """What samples are charged by: `measured`, or a profile's content."""
        known = self.request.cost == cost.MEASURED
        return cost.MEASURED if known else repr(cost.profile(self.request.cost))

    @cached_property
    def scores(self) -> str:
        """Hash of the metrics, their names and their code, and of the code that asks for them."""
        known = registry.entries("metrics")
        modules = [code_hash.import_closure(e.target.partition(":")[0]) for e in known.values()]
        told = code_hash.code_hash(set().union(*modules), core=MEASURE)
        metrics = registry.metrics().values()
        brought = sorted({name for each in metrics for name in getattr(each, "packages", ())})
        return f"{list(known)} {told} {provenance.package_versions(brought)}"

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
        brought = {n: registry.variant(n).requires for n in self.request.methods}
        return {
            name: ", ".join(
                filter(None, (self._weights(name), provenance.package_versions(packages)))
            )
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
        fold = (
            f"{results.FOLD}{self.request.held_out_scene} " if self.request.held_out_scene else ""
        )
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
        beside = _found(registry.module_file, family.build)
        return Path(beside).parent / "cards" / family.weights(name.partition("/")[2])


def _stem(file: str) -> str:
    """What weights without a name are called: as their file, but never as rows of other kinds."""
    called = re.sub(r"[^\w+-]", "-", Path(file).stem, flags=re.ASCII)
    other = called.partition("-")[0] in (results.HALF, results.CROSSVAL)
    return f"weights-{called}" if other else called


def _code(target: str) -> str:
    """Hash of what builds a method, and of what that imports of its package and of others'."""
    module = target.partition(":")[0]
    loose = registry.plugin_file(module)
    if loose is None:
        return code_hash.code_hash(code_hash.import_closure(module, _others()))
    told = code_hash.code_hash(code_hash.closure_of_file(loose, _others()))
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
