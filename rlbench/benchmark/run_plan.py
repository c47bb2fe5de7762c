"""What is to be measured, and which stored cells of one title replace each other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import product
from urllib.parse import quote, unquote

import torch

from rlbench import registry
from rlbench.benchmark import cost, latency
from rlbench.benchmark.clip_sources import Source
from rlbench.errors import RlbenchError

SPP = (0.5, 1.0, 2.0, 4.0)  # budgets if none are asked for
FAILED = "failed"  # instead of a hash
FIRST = "first"  # before the hash of a cell that is of the first frames alone


class CellsError(RlbenchError, ValueError):
    """Cells that results could not tell apart."""


@dataclass(frozen=True)
class RunPlan:
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
    weights_label: str = ""  # name of the weights, where several of one method are to be told apart
    held_out_scene: str = ""  # scene that `weights` were not trained on, in a cross-validation

    def runs_in_bf16(self, method: str) -> bool:
        """Does a method compute in half precision? One without networks has nothing to halve."""
        return self.half and registry.variant(method).learned


@dataclass(frozen=True)
class Cell:
    """One method on one clip at one budget with one seed."""

    method: str
    clip: Source
    spp: float
    seed: int


def cells(request: RunPlan) -> list[Cell]:
    """Every cell of a request, clip by clip."""
    grid = product(request.clips, request.methods, request.spp, request.seeds)
    return [Cell(method, clip, spp, seed) for clip, method, spp, seed in grid]


def check_unique_names(request: RunPlan) -> None:
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


def content_key(preset: str, frames: int | None, told: str) -> str:
    """The end of a cell's name: the clip's preset, whether it is cut short, and a hash of all."""
    return f"{quote(preset, safe='')},{FIRST if frames else ''},{told}"


def check_no_overwrite(name: str, stored: Mapping[str, set[str]]) -> None:
    """Raise CellsError where first frames alone would replace a whole clip's scores, or a preset's
    clip those of another preset's clip of the same name.
    """
    preset, first, _ = name.rpartition(" ")[2].split(",")
    for each in superseded_cells(name, stored):
        title, _, known = each.rpartition(" ")
        if known.count(",") != 2:  # of one that failed, or of a version that did not tell
            continue
        other, known_first, _ = known.split(",")
        if other != preset:
            now, was = (f"preset {unquote(it)}" if it else "no preset" for it in (preset, other))
            raise CellsError(
                f"'{title}' is known of {was}, and that of {now} would replace it, for clips are "
                "told apart by name; give --out another folder"
            )
        if first and not known_first:
            raise CellsError(
                f"'{title}' is known of the whole clip, and --limit-frames would replace it; give "
                "--out another folder"
            )


def superseded_cells(name: str, stored: Mapping[str, set[str]]) -> set[str]:
    """The stored cells that a cell replaces: those of the same title and other content."""
    return stored.get(name.rpartition(" ")[0], set()) - {name}
