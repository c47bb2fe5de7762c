"""Content hashes of cells: a hash of all that a cell's scores depend on, and one of its times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import product
from pathlib import Path

import torch

from rlbench import registry
from rlbench.backends import EAGER
from rlbench.benchmark import cost
from rlbench.benchmark.cell_key import CellId
from rlbench.benchmark.cost_profile import MEASURED, read_profile
from rlbench.benchmark.results import HELD_OUT_PREFIX
from rlbench.benchmark.run_plan import Cell, RunPlan, list_cells
from rlbench.benchmark.sample_clock import clock_modules
from rlbench.clips.header import ClipError, Header
from rlbench.system import code_hash, provenance

SCORING = ("rlbench.benchmark.scoring",)  # images to numbers
TIMING = (
    "rlbench.benchmark.clock",
    "rlbench.benchmark.cost",
    "rlbench.benchmark.cost_profile",
    "rlbench.benchmark.latency",
    "rlbench.benchmark.timing",
    "rlbench.system.process_settings",
)  # modules that measure times


@dataclass(frozen=True)
class CellIds:
    """Identities of the cells of a plan; hashes that cells share are computed once."""

    plan: RunPlan

    def cell_id(self, cell: Cell) -> CellId:
        """The cell's key, and the hashes of its scores and times."""
        plan, name, header = self.plan, cell.method_name, cell.header
        wrappers = ["rlbench.wrappers"]
        content = (
            *(name, _clip_content(cell)),
            *header_facts(header),
            *(cell.spp, cell.key.seed, cell.key.device),
            *(self.code_hashes[name], self.weights_hashes[name], self._scoring),
            *(plan.limit_frames, torch.__version__, cell.is_trained_on_clip),
            self._code(*wrappers) if cell.half else "",
            *((self._backend,) if cell.backend != EAGER else ()),
            *((self._code(*wrappers, "rlbench.ops.tiles"),) if cell.skip_tiles else ()),
        )
        times = (
            self._cost,
            plan.repeats,
            self._charged(cell),
            self._code(*TIMING, *clock_modules()),
        )
        return CellId(cell.key, _short_hash(content), _short_hash(times))

    @cached_property
    def cells(self) -> list[Cell]:
        """Every cell of the plan."""
        return list_cells(self.plan)

    @cached_property
    def run_id(self) -> str:
        """Hash of the whole plan: the same command on the same content has the same."""
        ids = repr([self.cell_id(cell) for cell in self.cells])
        return sha256(ids.encode()).hexdigest()[:12]

    @cached_property
    def code_hashes(self) -> dict[str, str]:
        """Hash of each method's code and of the core code that hands it its samples.

        Empty where the code cannot be found; building the method then reports the reason.
        """
        return {name: registry.method_code_hash(name) for name in self.plan.methods}

    @cached_property
    def weights_hashes(self) -> dict[str, str]:
        """Hash of each method's weights and versions of the packages that make its images."""
        cells = {cell.method_name: cell for cell in self.cells}
        return {name: self._weights_hash(cell) for name, cell in cells.items()}

    @cached_property
    def _scoring(self) -> str:
        return scoring_content()

    @cached_property
    def _codes(self) -> dict[tuple[str, ...], str]:
        return {}

    def _code(self, *modules: str) -> str:
        """Hash of the code of these modules, whatever they import."""
        if modules not in self._codes:
            self._codes[modules] = code_hash.code_hash(modules, core=())
        return self._codes[modules]

    @cached_property
    def _backend(self) -> str:
        """The plan's backend, a hash of its code, and the version of its package."""
        hashed = self._code("rlbench.backends")
        return f"{self.plan.backend} {hashed} {provenance.package_versions(['openvino'])}"

    @cached_property
    def _machine(self) -> str:
        """The machine whose path tracer samples are charged by."""
        return provenance.machine().name

    @cached_property
    def _cost(self) -> str:
        """What samples are charged by: `measured`, or the content of a cost profile."""
        is_measured = self.plan.cost == MEASURED
        return MEASURED if is_measured else repr(read_profile(self.plan.cost))

    @cached_property
    def _tracing(self) -> dict[tuple[str, str], str]:
        """What times a sample of each clip and pool here; empty where the header has its time."""
        pools = {cell.traits.pool for cell in self.cells}
        return {
            (clip.header.name, pool): cost.tracing(clip.header, self._machine, pool)
            for clip, pool in product(self.plan.clips, pools)
        }

    def _charged(self, cell: Cell) -> tuple[object, ...]:
        """What the cost of a sample depends on, beyond the profile.

        A profile knows the cost of path samples in every scene, and of another pool only relative
        to the path samples of the clip's renderer.
        """
        header, pool = cell.header, cell.traits.pool
        gbuffer = (header.gbuffer_ms, header.sample_ms) if cell.traits.inputs else ()
        if self.plan.cost == MEASURED:
            spread = header.sample_p5_ms, header.sample_p95_ms, header.tracer_of_times
            tracing = self._machine, self._tracing[header.name, pool]
            return header.sample_ms_of(pool), header.device, *tracing, spread, gbuffer
        if pool == "path":
            return gbuffer
        return header.sample_ms_of(pool), header.sample_ms_of("path"), header.device, gbuffer

    def _weights_hash(self, cell: Cell) -> str:
        file, held_out = cell.weights_file, self.plan.held_out_scene
        content = "random" if cell.variant.learned else ""
        if file is not None:
            content = f"{HELD_OUT_PREFIX}{held_out} " if held_out else ""
            content += hash_file(file)
        parts = content, provenance.package_versions(cell.variant.requires)
        return ", ".join(filter(None, parts))


def header_facts(header: Header) -> tuple[object, ...]:
    """What rows take from a clip's header beside its images."""
    return header.cuts, header.light_changes, header.noise_ceiling_db, header.limitations


def scoring_content() -> str:
    """Names of the run's metrics, hash of their code and of `SCORING`, and package versions."""
    metrics = registry.load_run_metrics() | registry.load_memory_metrics()
    hashed = registry.metrics_code_hash(metrics, SCORING)
    packages = sorted({name for metric in metrics.values() for name in metric.requires})
    return f"{list(metrics)} {hashed} {provenance.package_versions(packages)}"


def _clip_content(cell: Cell) -> str:
    """Hash of the cell's clip; what is wrong with it where files are missing.

    Opening such a clip raises the same error, so its cells fail, and no others.
    """
    try:
        return cell.clip.content(cell.traits.pool)
    except ClipError as error:
        return str(error)


def _short_hash(content: object) -> str:
    return sha256(repr(content).encode()).hexdigest()[:16]


def hash_file(file: Path) -> str:
    """Hash of a file's name and content; empty without a file."""
    if not file.is_file():
        return ""
    return sha256(file.name.encode() + b"\0" + file.read_bytes()).hexdigest()[:16]
