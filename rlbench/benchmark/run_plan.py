"""A run plan, its cells, and how a cell is loaded: where a run begins.

A cell is one method on one clip at one budget with one seed.
"""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import torch

from rlbench import registry
from rlbench.backends import EAGER, applicable_backend, use_backend
from rlbench.benchmark.cell_key import CellKey, CellsError
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.cost_profile import MEASURED
from rlbench.benchmark.latency import REPEATS, device_name
from rlbench.benchmark.results import CROSSVAL, HALF, RESERVED_LABELS, TILES, RowName
from rlbench.benchmark.run_options import DEFAULT_SPP
from rlbench.clips.compatibility import incompatibility
from rlbench.clips.header import Header
from rlbench.family import Traits, Variant
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.returns import CheckedReturns
from rlbench.system.half_precision import half_dtype, require_half
from rlbench.weights import training_clips
from rlbench.wrappers import HalfPrecision, SkipTiles

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunPlan:
    """Methods x clips x budgets x seeds to measure on one device."""

    methods: tuple[str, ...]  # family or family/variant
    clips: tuple[StoredSource, ...]
    spp: tuple[float, ...] = DEFAULT_SPP  # budgets, samples per pixel
    seeds: tuple[int, ...] = (0,)  # of the sample order and of rounding
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    cost: str = MEASURED  # or a cost profile: a shipped one, or the path of a TOML file
    weights: str | None = None  # None for the shipped ones, "random", or the path of a file
    weights_for: tuple[str, ...] = ()  # the methods that `weights` are of; empty: all
    limit_frames: int | None = None  # first frames of each clip only, for a trial run
    repeats: int = REPEATS  # timed frames, at least
    half: bool = False  # run networks in half precision
    backend: str = EAGER  # that runs networks, see rlbench.backends
    skip_tiles: bool = False  # keep unchanged tiles of local methods, see rlbench.wrappers
    weights_label: str = ""  # label of the rows, to keep several weights of one method apart
    held_out_scene: str = ""  # scene that `weights` were trained without, in a cross-validation

    def __post_init__(self) -> None:
        """End each clip after `limit_frames`."""
        if self.limit_frames:
            clips = tuple(clip.first(self.limit_frames) for clip in self.clips)
            object.__setattr__(self, "clips", clips)

    def check_unique_names(self) -> None:
        """Raise CellsError where two clips have one name: one would replace the other."""
        names = [clip.header.name for clip in self.clips]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise CellsError(
                f"{names.count(repeated[0])} of the clips are called '{repeated[0]}', and results "
                "are keyed by clip name. Change `name` in clip.toml, or use two results folders"
            )


@dataclass(frozen=True)
class Cell:
    """One method on one clip at one budget with one seed, with what decides its images."""

    key: CellKey  # row name, clip, budget, seed and device
    clip: StoredSource
    method_name: str  # family or family/variant, the row name without its label
    variant: Variant
    half: bool  # True if its networks run in half precision
    backend: str  # that runs its networks
    skip_tiles: bool  # True if unchanged tiles are kept from the last image
    weights_file: Path | None  # None for random weights, and without networks
    training_clips: frozenset[str]  # names of the clips that the weights were trained on

    @property
    def traits(self) -> Traits:
        """The method's traits."""
        return self.variant.traits

    @property
    def header(self) -> Header:
        """The clip's header."""
        return self.clip.header

    @property
    def spp(self) -> float:
        """The budget, samples per pixel."""
        return self.key.target_spp

    @property
    def pool_spp(self) -> int:
        """Samples that one pixel can have."""
        return self.clip.pool_spp(self.spp)

    @property
    def is_trained_on_clip(self) -> bool:
        """True if the weights were trained on this clip, according to their card."""
        return self.header.name in self.training_clips

    @property
    def incompatibility(self) -> str | None:
        """Why the method cannot run on the clip, as far as header and traits say, or None."""
        return incompatibility(self.header, self.traits, self.spp, self.pool_spp)


def list_cells(plan: RunPlan) -> list[Cell]:
    """Every cell of a plan, clip by clip. Raises PluginError for an unknown method."""
    device, is_short = device_name(plan.device), bool(plan.limit_frames)
    variants = {name: registry.get_variant(name) for name in plan.methods}
    files = {name: _weights_file(plan, name, each) for name, each in variants.items()}
    rows = {name: row_name(plan, name) for name in plan.methods}
    trained_on = {name: training_clips(file) for name, file in files.items()}
    return [
        Cell(
            key=CellKey(
                rows[name], clip.header.name, spp, seed, device, clip.header.preset, is_short
            ),
            clip=clip,
            method_name=name,
            variant=variants[name],
            half=plan.half and variants[name].learned,
            backend=_backend_of(plan, variants[name]),
            skip_tiles=_skips_tiles(plan, variants[name]),
            weights_file=files[name],
            training_clips=trained_on[name],
        )
        for clip, name, spp, seed in product(
            plan.clips, plan.methods, map(float, plan.spp), plan.seeds
        )
    ]


def row_name(plan: RunPlan, name: str) -> str:
    """Name of a method's rows, labelled by what differs from the method as shipped.

    That is the backend, half precision, skipped tiles, other weights. Weights without a label are
    labelled by their file, if the method also has shipped weights.
    """
    variant = registry.get_variant(name)
    backend = _backend_of(plan, variant)
    parts = ["" if backend == EAGER else backend, TILES if _skips_tiles(plan, variant) else ""]
    if variant.learned:
        weights = chosen_weights(plan, name)
        label = plan.weights_label if weights == plan.weights else ""
        if weights and not label and _shipped_weights(name).is_file():
            label = _label_of_file(weights)
        label = CROSSVAL if plan.held_out_scene else label
        parts = [parts[0], HALF if plan.half else "", parts[1], label]
    return str(replace(RowName.parse(name), label="-".join(filter(None, parts))))


def _weights_file(plan: RunPlan, name: str, variant: Variant) -> Path | None:
    """Path of a method's weights, which may not exist; None for random ones, or no networks."""
    weights = chosen_weights(plan, name)
    if not variant.learned or weights == "random":
        return None
    return Path(weights) if weights else _shipped_weights(name)


def chosen_weights(plan: RunPlan, name: str) -> str | None:
    """The plan's weights if they are for this method; None for the shipped ones."""
    return plan.weights if not plan.weights_for or name in plan.weights_for else None


@dataclass(frozen=True)
class CellLoader:
    """Loads cells: each method is built once for all of them, and a clip is opened for each."""

    plan: RunPlan
    _methods: dict[str, Method | Exception] = field(default_factory=dict, repr=False, compare=False)

    def method(self, cell: Cell) -> Method:
        """The cell's method. Raises what building it raised, the first time and every time."""
        if cell.method_name not in self._methods:
            _logger.info("%s: built with weights %s", cell.method_name, cell.weights_file or "none")
            try:
                if cell.half:
                    require_half(self.plan.device)  # also on the workers of an executor
                self._methods[cell.method_name] = build_method(
                    cell.method_name,
                    self.plan.device,
                    chosen_weights(self.plan, cell.method_name),
                    backend=cell.backend,
                    half=cell.half,
                    skip_tiles=cell.skip_tiles,
                )
            except Exception as error:  # missing weights or packages: a reason for each cell
                self._methods[cell.method_name] = error
        method = self._methods[cell.method_name]
        if isinstance(method, Exception):
            raise method
        return method

    def clip(self, cell: Cell, scored_buffers: frozenset[str] = frozenset()) -> Clip:
        """The cell's clip, with the frames of the plan and the data that the method can use.

        `scored_buffers` are read too, where the clip has them: for metrics, as a method receives
        only the buffers that it declares.
        """
        inputs = cell.traits.inputs | (scored_buffers & set(cell.header.buffers))
        traits = replace(cell.traits, inputs=inputs)
        return cell.clip.open(traits, cell.spp, cell.key.seed, self.plan.device)


def build_method(
    name: str,
    device: torch.device,
    weights: str | None = None,
    *,
    backend: str = EAGER,
    half: bool = False,
    skip_tiles: bool = False,
) -> Method:
    """A method as it is measured: what it returns is checked, and these options are applied.

    `weights` are as those of a plan. Raises what building the method raises, and OptionError for a
    backend that the device does not have.
    """
    method: Method = CheckedReturns(registry.load_method(name, device, weights))
    method = use_backend(method, backend, device, half)
    method = HalfPrecision(method, device, half_dtype(device)) if half else method
    return SkipTiles(method) if skip_tiles else method


def _backend_of(plan: RunPlan, variant: Variant) -> str:
    return applicable_backend(plan.backend, variant, skips_tiles=_skips_tiles(plan, variant))


def _skips_tiles(plan: RunPlan, variant: Variant) -> bool:
    return plan.skip_tiles and variant.traits.receptive_field is not None


def _label_of_file(file: str) -> str:
    """The label of weights without one: the file's name, but never a reserved label."""
    label = re.sub(r"[^\w+-]", "-", Path(file).stem, flags=re.ASCII)
    return f"weights-{label}" if label.partition("-")[0] in RESERVED_LABELS else label


def _shipped_weights(name: str) -> Path:
    """Path of the weights that a method ships with; the file may not exist."""
    try:
        return registry.shipped_weights(name)
    except LookupError:  # building the method reports the missing module
        return Path("missing")
