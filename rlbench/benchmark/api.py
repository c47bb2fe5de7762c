"""Score, render, list and report from Python, as the commands of the shell do.

    import rlbench

    scores = rlbench.run(["ours", "ntas"], spp=[1, 4], scenes=["city"])  # a pandas DataFrame
    psnr = scores[scores["metric"] == "psnr"]
    print(psnr.groupby(["method", "target_spp"])["value"].mean().unstack())
    rlbench.report("pareto", out="figures")

`run` stores results as it goes: a second call measures only what is missing or has changed.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Iterable
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import torch

from rlbench import registry
from rlbench.backends import EAGER, select_backend
from rlbench.benchmark import latency, results
from rlbench.benchmark.clip_sources import StoredSource, list_pools, open_source
from rlbench.benchmark.cost_profile import MEASURED, read_profile
from rlbench.benchmark.run_outcome import RunWarning, judge_run
from rlbench.benchmark.run_plan import DEFAULT_SPP, RunPlan
from rlbench.benchmark.runner import CellCallback, measure, read_cells
from rlbench.clips.presets import get_preset
from rlbench.clips.rendering import render_preset_clips
from rlbench.clips.stored import find_all_clips
from rlbench.errors import OptionError, names_arguments
from rlbench.parallel.executor import LOCAL, Executor
from rlbench.registry.near_names import unknown_name
from rlbench.system import paths
from rlbench.system.bfloat16 import require_native_bf16
from rlbench.system.paths import check_writable
from rlbench.weights import read_card

if TYPE_CHECKING:
    import pandas as pd

RESULTS = Path("results")
_NUMBERS = "give numbers, {}: one, or a list such as [{}]"


@names_arguments
def run(
    methods: str | Iterable[str] = ("all",),
    *,
    plugin: Path | str | Iterable[Path | str] = (),
    spp: float | Iterable[float] = DEFAULT_SPP,
    scenes: str | Iterable[str] = (),
    preset: str = "mini",
    size: tuple[int, int] | None = None,
    takes: str | None = None,
    clips: Path | str | Iterable[Path | str] | None = None,
    pool: str = "stored",
    seeds: int | Iterable[int] = (0,),
    device: str = "auto",
    cost: str = MEASURED,
    weights: Path | str | None = None,
    weights_label: str = "",
    weights_for: str | Iterable[str] = (),
    bf16: bool = False,
    backend: str = EAGER,
    skip_tiles: bool = False,
    limit_frames: int | None = None,
    retime: Literal["uncertain", "all"] | None = None,
    scores_only: bool = False,
    keep_images: bool = False,
    out: Path | str = RESULTS,
    executor: Executor = LOCAL,
    on_cell: CellCallback = lambda cell: None,
) -> pd.DataFrame:
    """Score and time methods on clips; returns the rows of this call, one number a row.

    `methods` is one name or several, or patterns such as `ours`, `oidn/*` or `all`; `plugin` is a
    Python file with methods or metrics, or several, which stay known after the call. `spp` are
    budgets in samples per pixel. Clips are those of a `preset`, at its size or at `size` pixels
    (height, width), all or the given `scenes` and `takes` ("main", "all"), and are rendered where
    they are missing; or those in the folders `clips`.
    `weights` is the path of a file or "random", whose rows are named `METHOD@weights_label`; None
    takes the shipped weights, as do methods that are not among `weights_for`, if it names any.
    `backend` runs the networks: "eager" is PyTorch, "openvino" and "compile" (torch.compile) are
    compilers, for rows `METHOD@openvino`, "graph" records the stages of a frame as CUDA graphs, and
    "auto" takes OpenVINO where it is installed. `skip_tiles` keeps unchanged tiles of methods with
    a receptive field, for rows `METHOD@tiles`. `cost` is "measured", the name of a cost profile, or
    a TOML file.
    Results are kept in the folder `out`; cells that it holds already are not measured again.
    `retime` measures the times of cells again whose scores are there, and no scores: those that are
    "uncertain", or "all"; `scores_only`
    measures no times, and a later call without it measures those that are missing. With
    `limit_frames` only the first frames of each clip are rendered and measured. `keep_images`
    keeps the image of each frame in the folder `images` of `out`. `on_cell` is called with each
    finished cell.

    A cell that an error stopped is one row with value nan, whose `note` is the error. It does not
    stop the other cells: a RunWarning names it, and cells with images that are not finite. So is
    each cell of a method whose plugin cannot be imported.

    Raises RlbenchError for names, budgets, files or devices that cannot be used.
    """
    patterns, folder = _as_list(methods), Path(out)
    for file in _as_list(plugin):
        registry.use_plugin(file)
    with registry.with_broken(patterns):
        plan = plan_run(
            registry.expand(patterns),
            folder,
            spp=spp,
            scenes=scenes,
            preset=preset,
            size=size,
            takes=takes,
            clips=clips,
            pool=pool,
            seeds=seeds,
            device=device,
            cost=cost,
            weights=weights,
            weights_label=weights_label,
            weights_for=weights_for,
            bf16=bf16,
            backend=backend,
            skip_tiles=skip_tiles,
            limit_frames=limit_frames,
            executor=executor,
        )
        summary = measure(
            plan,
            folder,
            on_cell,
            executor,
            retime=retime,
            scores_only=scores_only,
            keep_images=keep_images,
        )
        rows = read_cells(plan, folder)
    if not (verdict := judge_run(summary, rows)).has_passed:
        warnings.warn(f"{verdict}. The column `note` has the reasons", RunWarning, stacklevel=3)
    return rows


def plan_run(
    methods: Iterable[str],
    out: Path,
    *,
    spp: float | Iterable[float] = DEFAULT_SPP,
    scenes: str | Iterable[str] = (),
    preset: str = "mini",
    size: tuple[int, int] | None = None,
    takes: str | None = None,
    clips: Path | str | Iterable[Path | str] | None = None,
    pool: str = "stored",
    seeds: int | Iterable[int] = (0,),
    device: str = "auto",
    cost: str = MEASURED,
    weights: Path | str | None = None,
    weights_label: str = "",
    weights_for: str | Iterable[str] = (),
    bf16: bool = False,
    backend: str = EAGER,
    skip_tiles: bool = False,
    limit_frames: int | None = None,
    repeats: int = latency.REPEATS,
    executor: Executor = LOCAL,
) -> RunPlan:
    """The plan of `run` for methods by name; everything is checked before a clip is rendered.

    Raises RlbenchError for names, budgets, files or devices that cannot be used.
    """
    names, budgets, target = tuple(methods), check_budget_values(spp), select_device(device)
    file = None if weights is None else str(weights)
    selected_backend = select_backend(backend, target)
    check_precision(names, bf16, device, executor)
    check_run(names, budgets, out, None if clips else preset, cost, file, pool)
    pool_kinds = {registry.get_variant(name).traits.pool for name in names}
    return RunPlan(
        methods=names,
        clips=select_clips(
            clips, scenes, preset, takes, pool, pool_kinds, executor, size, limit_frames
        ),
        spp=budgets,
        seeds=check_seeds(seeds),
        device=target,
        cost=cost,
        weights=file,
        weights_label=weights_label,
        weights_for=tuple(_as_list(weights_for)),
        bf16=bf16,
        backend=selected_backend,
        skip_tiles=skip_tiles,
        limit_frames=limit_frames,
        repeats=repeats,
    )


@names_arguments
def render_clips(
    preset: str = "mini",
    *,
    scenes: str | Iterable[str] = (),
    takes: str | None = None,
    seeds: int | Iterable[int] | None = None,
    size: tuple[int, int] | None = None,
    limit_frames: int | None = None,
    executor: Executor = LOCAL,
) -> list[Path]:
    """Render the missing clips of a preset; returns the folders of all requested clips.

    `seeds` are those of generated scenes (presets `train` and `unseen`), `size` is the height and
    width in pixels where it is not the preset's. With `limit_frames` only the first frames of each
    clip are rendered, and a later call renders the others. Open a folder with
    `rlbench.open_clip`. Raises RlbenchError for an unknown preset, scene or take.
    """
    return render_preset_clips(
        _as_list(scenes),
        preset,
        seeds=None if seeds is None else check_seeds(seeds),
        takes=takes,
        executor=executor,
        size=size,
        limit_frames=check_limit(limit_frames),
    )


@names_arguments
def report(
    name: str,
    rows: pd.DataFrame | None = None,
    *,
    folder: Path | str = RESULTS,
    out: Path | str | None = None,
) -> list[Path]:
    """Write a report, such as "summary" or "pareto"; returns the files.

    `rows` are results as `run` returns them; by default all rows in the results `folder` are read.
    Files go to the folder `out`, by default `report` in the results folder. Raises RlbenchError for
    an unknown report and for rows that it cannot use.
    """
    table = results.read(Path(folder)) if rows is None else rows
    write = registry.load_or_explain("reports", name)
    return list(write(table, Path(folder) / "report" if out is None else Path(out)))


def select_clips(
    clips: Path | str | Iterable[Path | str] | None,
    scenes: str | Iterable[str] = (),
    preset: str = "mini",
    takes: str | None = None,
    pool: str = "stored",
    pool_kinds: Collection[str] | None = None,
    executor: Executor = LOCAL,
    size: tuple[int, int] | None = None,
    limit_frames: int | None = None,
) -> tuple[StoredSource, ...]:
    """The clips in the folders `clips`, or those of a preset, rendered where they are missing.

    `size` is the height and width in pixels of a preset's clips. `scenes` selects by the name of a
    scene or a clip. Samples are those that are "stored", or come from a "live" path tracer. Only
    the preset's pools of the given kinds are rendered; None renders all. With `limit_frames` only
    the first frames of a preset's clips are rendered, and clips in folders stay whole. Raises
    RlbenchError where a selection is empty or contradictory.
    """
    selected, limit_frames = _as_list(scenes), check_limit(limit_frames)
    if pool not in (pools := list_pools()):
        raise OptionError(unknown_name(f"no pool '{pool}'", pool, pools))
    if clips is None:
        folders = render_preset_clips(
            selected,
            preset,
            executor=executor,
            pool_kinds=pool_kinds,
            takes=takes,
            size=size,
            limit_frames=limit_frames,
        )
        return tuple(open_source(folder, pool) for folder in folders)
    if takes is not None or size is not None:
        option = "--takes" if takes is not None else "--size"
        raise OptionError(
            f"{option} applies to preset scenes only. With --clips, select clips by name: "
            "--scenes NAME"
        )
    sources = [open_source(path, pool) for path in find_all_clips(_as_list(clips))]
    names = {source: {source.header.scene, source.header.name} for source in sources}
    available = sorted(set().union(*names.values()))
    if unknown := [name for name in selected if name not in available]:
        problem = f"the clips show no scene {', '.join(unknown)}"
        raise OptionError(unknown_name(problem, unknown[0], available))
    return tuple(source for source in sources if not selected or names[source] & set(selected))


def check_budget_values(spp: float | Iterable[float]) -> tuple[float, ...]:
    """Different budgets in their order. Raises OptionError unless all are finite and above 0."""
    given = _as_list(spp)
    if not given or not all(_is_number(each) and 0 < each < math.inf for each in given):
        raise OptionError(
            f"--spp {spp!r}: {_NUMBERS.format('samples per pixel above 0', '0.5, 1')}"
        )
    return tuple(dict.fromkeys(map(float, given)))


def check_seeds(seeds: int | Iterable[int]) -> tuple[int, ...]:
    """Different seeds in their order. Raises OptionError unless all are whole numbers from 0 on."""
    given = _as_list(seeds)
    if not given or not all(_is_number(each) and each == int(each) >= 0 for each in given):
        raise OptionError(f"--seed {seeds!r}: {_NUMBERS.format('whole numbers from 0 on', '0, 1')}")
    return tuple(dict.fromkeys(map(int, given)))


def check_limit(frames: int | None) -> int | None:
    """A limit of frames. Raises OptionError unless it is a whole number above 0."""
    if frames is not None and not (_is_number(frames) and frames == int(frames) >= 1):
        raise OptionError(f"--limit-frames {frames!r}: give a whole number of frames, at least 1")
    return frames


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _as_list(values: Any) -> list[Any]:
    """One value or several as a list; a text is one value."""
    return (
        list(values) if isinstance(values, Iterable) and not isinstance(values, str) else [values]
    )


def check_precision(
    methods: Iterable[str], bf16: bool, device: str, executor: Executor = LOCAL
) -> None:
    """Raise OptionError if networks were to run in bfloat16 on a device that emulates it.

    Other machines are asked by the executor's workers, cell by cell.
    """
    has_networks = any(registry.get_variant(name).learned for name in methods)
    if bf16 and has_networks and not executor.description:
        require_native_bf16(select_device(device))


def select_device(name: str = "auto") -> torch.device:
    """The device of that name; "auto" is CUDA where it is available. Raises OptionError."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:  # its message names 25 back ends
        raise OptionError(
            f"device {name} cannot be used on this machine, it is not known. Use cpu, cuda or auto"
        ) from error
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).partition("\n")[0]
        raise OptionError(
            f"device {name} cannot be used on this machine: {reason}. Use cpu or auto"
        ) from error
    return device


def check_run(
    methods: Collection[str],
    spp: Collection[float],
    out: Path,
    preset: str | None,
    cost: str = MEASURED,
    weights: str | None = None,
    pool: str = "stored",
) -> None:
    """Check the options of a run that need no clip; nothing is written and no clip is opened.

    `preset` is that of the clips, None for clips in folders; their samples are those of `pool`
    (`rlbench.benchmark.clip_sources.list_pools`). Raises CostError for a cost profile,
    WeightsError for a weights file or its card, PluginError for a metric that cannot be used,
    WriteError where the results or the cache cannot be written, UnknownPresetError, and
    OptionError where no method can be measured at any budget.
    """
    if cost != MEASURED:
        read_profile(cost)
    if weights not in (None, "random"):
        read_card(Path(weights))
    if preset is not None:
        check_budgets(methods, spp, preset, pool)
    registry.load_run_metrics()
    check_writable(out)
    check_writable(paths.cache_folder(), "RLBENCH_CACHE")


def check_budgets(
    methods: Collection[str], spp: Collection[float], preset: str, pool: str = "stored"
) -> None:
    """Raise OptionError where no method can be measured on the preset's clips at any budget.

    A method that cannot at some budgets is skipped there, with the reason in its row. Live samples
    are traced when they are drawn, so there are as many as a budget needs.
    """
    stored = get_preset(preset).pool_spp
    if pool == "stored" and min(spp, default=0.0) > stored:
        raise OptionError(
            f"--spp {_join(spp)}: the clips of preset '{preset}' store {stored} samples per "
            f"pixel, and no method is measured with more; request at most {stored}, or trace "
            "more with --pool live"
        )
    traits = {name: registry.get_variant(name).traits for name in methods}
    reasons = {
        f"{name} {reason}": None
        for budget in spp
        for name, each in traits.items()
        if (reason := each.unsupported_reason(budget))
    }
    if reasons and len(reasons) == len(traits) * len(spp):
        raise OptionError(f"--spp {_join(spp)}: {'; '.join(reasons)}")


def _join(budgets: Collection[float]) -> str:
    return ",".join(f"{spp:g}" for spp in budgets)
