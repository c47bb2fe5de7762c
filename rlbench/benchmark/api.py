"""Benchmark, render, list and report from Python, as the commands of the shell do.

    >>> import rlbench
    >>> scores = rlbench.run(["ours", "ntas"], spp=[1, 4], scenes=["city"])  # doctest: +SKIP
    >>> scores.query("metric == 'psnr'").groupby(["method", "target_spp"])["value"].mean()
    ... # doctest: +SKIP

`run` stores results as it goes: a second call measures only what is missing or has changed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from rlbench import registry
from rlbench.benchmark import cost, results
from rlbench.benchmark.clip_sources import POOLS, StoredSource, open_source
from rlbench.benchmark.listing import list_installed
from rlbench.benchmark.run_plan import SPP, Cell, RunPlan
from rlbench.benchmark.runner import measure
from rlbench.clips.stored import find_clips
from rlbench.errors import OptionError
from rlbench.parallel.executor import LOCAL, Executor
from rlbench.render.jobs.preset_clips import render_preset

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["list_installed", "plan_run", "render", "report", "run", "select_clips"]

RESULTS = Path("results")


def run(
    methods: Iterable[str] = ("all",),
    *,
    spp: Iterable[float] = SPP,
    scenes: Iterable[str] = (),
    preset: str = "mini",
    takes: str | None = None,
    clips: Iterable[Path | str] = (),
    pool: str = "stored",
    seeds: Iterable[int] = (0,),
    device: torch.device | str = "auto",
    cost: str = cost.MEASURED,
    weights: Path | str | None = None,
    weights_label: str = "",
    bf16: bool = False,
    first_frames: int | None = None,
    out: Path | str = RESULTS,
    executor: Executor = LOCAL,
    on_cell: Callable[[Cell], None] = lambda cell: None,
) -> pd.DataFrame:
    """Score and time methods on clips; the rows that belong to this call, one number a row.

    `methods` are names such as `ours`, `ours/A1`, `oidn/*` or `all`. `spp` are budgets in samples
    per pixel. Clips are those of a `preset`, limited to `scenes`, or those in the folders `clips`;
    missing clips of a preset are rendered first. `weights` is a file, or `"random"`; rows are then
    named `METHOD@weights_label`. `cost` is `measured`, a profile, or a TOML file. Results are kept
    in the folder `out`, and cells that are there already are not measured again.

    Raises RlbenchError for names, budgets, files and devices that cannot be used.
    """
    plan = plan_run(
        methods,
        spp=spp,
        scenes=scenes,
        preset=preset,
        takes=takes,
        clips=clips,
        pool=pool,
        seeds=seeds,
        device=device,
        cost=cost,
        weights=weights,
        weights_label=weights_label,
        bf16=bf16,
        first_frames=first_frames,
        executor=executor,
    )
    out = Path(out)
    measure(plan, out, on_cell, executor)
    return results.rows_of(results.read(out), plan)
