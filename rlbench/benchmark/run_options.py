"""The options of a run: arguments of `rlbench.run`, of a plan, and of the command of the shell."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rlbench.benchmark.cost_profile import MEASURED
from rlbench.parallel.executor import LOCAL, Executor

if TYPE_CHECKING:
    from rlbench.benchmark.run_plan import Cell

DEFAULT_SPP = (0.5, 1.0, 2.0, 4.0)

Times = Literal["missing", "uncertain", "again", "none"]  # the times that a run measures
AGAIN = ("uncertain", "again")  # of cells that have scores; such a run measures no scores


@dataclass(frozen=True)
class RunOptions:
    """What a run is asked for; `rlbench.run` describes each option, and `planning` checks them."""

    methods: str | Iterable[str] = ("all",)  # names, or patterns such as oidn/*
    _: KW_ONLY
    plugin: Path | str | Iterable[Path | str] = ()  # Python files with methods or metrics
    spp: float | Iterable[float] = DEFAULT_SPP  # budgets, samples per pixel
    scenes: str | Iterable[str] = ()  # names of scenes or clips; empty: all
    preset: str = "mini"
    size: tuple[int, int] | None = None  # height and width in pixels; None: that of the preset
    takes: str | None = None  # "main" or "all"; None: as in the preset
    clips: Path | str | Iterable[Path | str] | None = None  # folders, in place of a preset
    pool: str = "stored"  # or "live"
    seeds: int | Iterable[int] = (0,)  # of the sample order and of rounding
    device: str = "auto"
    cost: str = MEASURED  # or a cost profile: a shipped one, or the path of a TOML file
    weights: Path | str | None = None  # None: the shipped ones
    weights_label: str = ""
    weights_for: str | Iterable[str] = ()  # methods; empty: all
    half: bool = False
    backend: str = "eager"  # that runs networks, see rlbench.backends
    skip_tiles: bool = False
    limit_frames: int | None = None  # first frames of each clip
    repeats: int = 10  # timed frames of a row, at least
    times: Times = "missing"
    keep_images: bool = False
    out: Path | str = Path("results")
    executor: Executor = LOCAL  # that runs the cells
    on_cell: Callable[[Cell], None] = lambda cell: None
