"""A run plan: which methods are measured on which clips, at which budgets, and how."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from rlbench.backends import EAGER
from rlbench.benchmark import cost, latency
from rlbench.benchmark.cell_key import CellsError
from rlbench.benchmark.clip_sources import Source

__all__ = ["DEFAULT_SPP", "RunPlan"]

DEFAULT_SPP = (0.5, 1.0, 2.0, 4.0)  # budgets, samples per pixel


@dataclass(frozen=True)
class RunPlan:
    """Methods x clips x budgets x seeds to measure on one device."""

    methods: tuple[str, ...]  # family or family/variant
    clips: tuple[Source, ...]
    target_spp: tuple[float, ...] = DEFAULT_SPP  # budgets, samples per pixel
    seeds: tuple[int, ...] = (0,)  # of the sample order and of rounding
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    cost: str = cost.MEASURED  # or a cost profile: a shipped one, or the path of a TOML file
    weights: str | None = None  # None for the shipped ones, "random", or the path of a file
    limit_frames: int | None = None  # first frames of each clip only, for a trial run
    repeats: int = latency.REPEATS  # timed frames, at least
    bf16: bool = False  # run networks in bfloat16
    backend: str = EAGER  # that runs networks, see rlbench.backends
    skip_tiles: bool = False  # keep unchanged tiles of local methods, see rlbench.wrappers
    weights_label: str = ""  # label of the rows, to keep several weights of one method apart
    held_out_scene: str = ""  # scene that `weights` were trained without, in a cross-validation

    def check_unique_names(self) -> None:
        """Raise CellsError where two clips have one name: one would replace the other."""
        names = [clip.header.name for clip in self.clips]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise CellsError(
                f"{names.count(repeated[0])} of the clips are called '{repeated[0]}', and results "
                "are keyed by clip name. Change `name` in clip.toml, or use two results folders"
            )
