"""Cells of a run plan with what the registry and the clips say of them, looked up once."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from rlbench import registry
from rlbench.backends import EAGER
from rlbench.benchmark import latency
from rlbench.benchmark.cell_key import CellKey
from rlbench.benchmark.clip_sources import Source
from rlbench.benchmark.row_name import BF16, CROSSVAL, RESERVED_LABELS, TILES, RowName
from rlbench.benchmark.run_plan import RunPlan
from rlbench.clips.header import Header
from rlbench.family import Traits, Variant
from rlbench.weights import training_clips

__all__ = ["ResolvedCell", "ResolvedMethod", "resolve_cells", "resolve_method"]


@dataclass(frozen=True)
class ResolvedMethod:
    """A method of a run plan: its declaration, its weights and the name of its rows."""

    name: str  # family or family/variant
    row_name: str
    traits: Traits
    learned: bool
    requires: tuple[str, ...]  # distributions that make its images
    bf16: bool  # do its networks run in bfloat16?
    backend: str  # that runs its networks
    skip_tiles: bool  # are unchanged tiles kept from the last image?
    weights_file: Path | None  # None for random weights, and without networks
    training_clips: frozenset[str]  # names of the clips that the weights were trained on


@dataclass(frozen=True)
class ResolvedCell:
    """One method on one clip at one budget with one seed."""

    method: ResolvedMethod
    clip: Source
    key: CellKey

    @property
    def traits(self) -> Traits:
        """The method's traits."""
        return self.method.traits

    @property
    def header(self) -> Header:
        """The clip's header."""
        return self.clip.header

    @property
    def target_spp(self) -> float:
        """Requested samples per pixel."""
        return self.key.target_spp

    @property
    def pool_spp(self) -> int:
        """Samples that one pixel can have."""
        return self.clip.pool_spp(self.target_spp)

    @property
    def seed(self) -> int:
        """Seed of the sample order and of rounding."""
        return self.key.seed

    @property
    def is_trained_on_clip(self) -> bool:
        """Were the method's weights trained on this clip, according to their card?"""
        return self.header.name in self.method.training_clips


def resolve_cells(plan: RunPlan) -> list[ResolvedCell]:
    """Every cell of a plan, clip by clip. Raises PluginError for an unknown method."""
    methods = [resolve_method(plan, name) for name in plan.methods]
    device = latency.device_name(plan.device)
    return [
        ResolvedCell(
            method,
            clip,
            CellKey(
                method=method.row_name,
                clip=clip.header.name,
                target_spp=float(spp),
                seed=seed,
                device=device,
                preset=clip.header.preset,
                first_frames_only=bool(plan.limit_frames),
            ),
        )
        for clip, method, spp, seed in product(plan.clips, methods, plan.target_spp, plan.seeds)
    ]


def resolve_method(plan: RunPlan, name: str) -> ResolvedMethod:
    """A method of a plan. Raises PluginError if it is unknown."""
    variant = registry.get_variant(name)
    file = _weights_file(plan, name, variant)
    return ResolvedMethod(
        name=name,
        row_name=_row_name(plan, name, variant),
        traits=variant.traits,
        learned=variant.learned,
        requires=variant.requires,
        bf16=plan.bf16 and variant.learned,
        backend=plan.backend if variant.learned else EAGER,
        skip_tiles=plan.skip_tiles and variant.traits.receptive_field is not None,
        weights_file=file,
        training_clips=training_clips(file),
    )


def _row_name(plan: RunPlan, name: str, variant: Variant) -> str:
    """Name of a method's rows, labelled by what differs from the method as shipped.

    That is the backend, bfloat16, skipped tiles, and other weights. Weights without a label are
    labelled by their file, if the method also has shipped weights.
    """
    tiles = TILES if plan.skip_tiles and variant.traits.receptive_field is not None else ""
    if not variant.learned:
        return f"{name}@{tiles}" if tiles else name
    label = plan.weights_label
    if plan.weights and not label and _shipped_weights(name).is_file():
        label = _label_of_file(plan.weights)
    label = CROSSVAL if plan.held_out_scene else label
    backend = "" if plan.backend == EAGER else plan.backend
    parts = [backend, BF16 if plan.bf16 else "", tiles, label]
    row_name = RowName.parse(name)
    return str(RowName(row_name.family, row_name.variant, "-".join(filter(None, parts))))


def _label_of_file(file: str) -> str:
    """The label of weights without one: the file's name, but never a reserved label."""
    label = re.sub(r"[^\w+-]", "-", Path(file).stem, flags=re.ASCII)
    return f"weights-{label}" if label.partition("-")[0] in RESERVED_LABELS else label


def _weights_file(plan: RunPlan, name: str, variant: Variant) -> Path | None:
    """Path of a method's weights, which may not exist; None for random ones, or no networks."""
    if not variant.learned or plan.weights == "random":
        return None
    return Path(plan.weights) if plan.weights else _shipped_weights(name)


def _shipped_weights(name: str) -> Path:
    """Path of the weights that a method ships with; the file may not exist."""
    try:
        return registry.shipped_weights(name)
    except LookupError:  # building the method reports the missing module
        return Path("missing")
