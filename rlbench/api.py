"""What rlbench does, as functions for Python; commands of the shell call them.

    import rlbench

    scores = rlbench.run(["ours", "ntas"], spp=[1, 4], scenes=["city"])  # a pandas DataFrame
    psnr = scores[scores["metric"] == "psnr"]
    print(psnr.groupby(["method", "target_spp"])["value"].mean().unstack())
    rlbench.report("pareto", out="figures")

`run` stores results as it goes: a second call measures only what is missing or has changed. What
reads results alone loads no torch.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from rlbench.benchmark.run_options import RunOptions
from rlbench.errors import OptionError, names_arguments
from rlbench.parallel.executor import LOCAL, Executor
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    import pandas as pd

    from reports.compare import Comparison
    from reports.decide import Decision, GivenTimes

RESULTS = Path("results")
P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def takes_fields(record: Callable[P, R]) -> Callable[[Callable[[R], T]], Callable[P, T]]:
    """A function of a record becomes a function of the record's fields."""

    def decorate(function: Callable[[R], T]) -> Callable[P, T]:
        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> T:
            return function(record(*args, **kwargs))

        fields = inspect.signature(record).parameters.values()
        own = inspect.signature(function)
        call.__signature__ = own.replace(parameters=list(fields))  # type: ignore[attr-defined]
        return call

    return decorate


@names_arguments
@takes_fields(RunOptions)
def run(options: RunOptions) -> pd.DataFrame:
    """Score and time methods on clips; returns the rows of this call, one number a row.

    The arguments are the fields of `RunOptions`: `run("ours", spp=[1, 4])`.

    `methods` is one name or several, or patterns such as `ours`, `oidn/*` or `all`; `plugin` is a
    Python file with methods or metrics, or several, which stay known after the call. `spp` are
    budgets in samples per pixel. Clips are those of a `preset`, at its size or at `size` pixels
    (height, width), all or the given `scenes` and `takes` ("main", "all"), and are rendered where
    they are missing; or those in the folders `clips`. Samples are those that are "stored", or from
    the `pool` "live". `seeds` are those of the sample order and of rounding.
    `weights` is the path of a file or "random", whose rows are named `METHOD@weights_label`; None
    takes the shipped weights, as do methods that are not among `weights_for`, if it names any.
    `backend` runs the networks: "eager" is PyTorch, "openvino" and "compile" (torch.compile) are
    compilers, for rows `METHOD@openvino`, "graph" records the stages of a frame as CUDA graphs,
    "fused" compiles them first, and "auto" takes OpenVINO where it is installed. `skip_tiles` keeps
    unchanged tiles of methods with a receptive field, for rows `METHOD@tiles`. `cost` is
    "measured", the name of a cost profile, or a TOML file.
    Results are kept in the folder `out`; cells that it holds already are not measured again.
    `times` are those to measure: "missing" ones; "uncertain" ones or all "again", of cells that
    have scores, and no scores; or "none", and a later call measures those that are missing. A row
    has at least `repeats` timed frames. With `limit_frames` only the first frames of each clip are
    rendered and measured. `keep_images` keeps the image of each frame in the folder `images` of
    `out`. `executor` runs the cells, and `on_cell` is called with each that is finished.

    A cell that an error stopped is one row with value nan, whose `note` is the error. It does not
    stop the other cells: a RunWarning names it, and cells with images that are not finite. So is
    each cell of a method whose plugin cannot be imported.

    Raises RlbenchError for names, budgets, files or devices that cannot be used.
    """
    from rlbench import registry
    from rlbench.benchmark.planning import as_list, plan_run
    from rlbench.benchmark.run_outcome import RunWarning, judge_run
    from rlbench.benchmark.runner import measure, read_cells

    patterns, folder = as_list(options.methods), Path(options.out)
    for file in as_list(options.plugin):
        registry.use_plugin(file)
    with registry.with_broken(patterns):
        plan = plan_run(replace(options, methods=registry.expand(patterns)))
        summary = measure(
            plan,
            folder,
            options.on_cell,
            options.executor,
            times=options.times,
            keep_images=options.keep_images,
        )
        rows = read_cells(plan, folder)
    if not (verdict := judge_run(summary, rows)).has_passed:
        warnings.warn(f"{verdict}. The column `note` has the reasons", RunWarning, stacklevel=4)
    return rows


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
    from rlbench.benchmark.planning import as_list, check_limit, check_seeds
    from rlbench.clips.rendering import render_preset_clips

    return render_preset_clips(
        as_list(scenes),
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
    from rlbench import registry
    from rlbench.benchmark.results import read

    table = read(Path(folder)) if rows is None else rows
    write = registry.load_or_explain("reports", name)
    return list(write(table, Path(folder) / "report" if out is None else Path(out)))


@names_arguments
def decide(
    frame_ms: float,
    sample_ms: float | None = None,
    rows: pd.DataFrame | None = None,
    *,
    folder: Path | str = RESULTS,
    gbuffer_ms: float | None = None,
    cost: str = "",
    metric: str = "psnr",
    device: str = "",
    strict: bool = False,
    left_out: Sequence[str] = (),
    plugins: str = "",
) -> Decision:
    """Which denoiser, at how many samples, has the least error in a frame of `frame_ms`.

    `sample_ms` is your renderer's time for one sample of every pixel, `gbuffer_ms` that of its
    G-buffer; by default it costs as many samples as in the results. `rows` are results as `run`
    returns them; by default those in `folder` are read. `cost` is a cost profile whose times of
    methods, if it has any, and of a sample replace those of the results. The answer has
    `candidates`, the best first. `strict`, `left_out` and `plugins` are as in `reports.decide`.
    Raises RlbenchError where no denoiser fits, or rows cannot be compared.
    """
    from reports.decide import decide as decide_rows
    from rlbench.benchmark.cost_profile import MEASURED
    from rlbench.benchmark.results import read

    table = read(Path(folder)) if rows is None else rows
    given = _read_times(cost, table) if cost not in ("", MEASURED) else None
    sample = sample_ms if sample_ms is not None else given.sample_ms if given else None
    if given and not given.inference_ms:  # a profile of a renderer: methods as measured
        given = None
    if sample is None:
        raise OptionError("--sample-ms or --cost is needed: what a sample of every pixel costs")
    return decide_rows(
        table,
        sample,
        frame_ms,
        metric,
        device,
        left_out,
        strict,
        gbuffer_ms,
        given,
        plugins,
    )


@names_arguments
def compare(
    first: str,
    second: str,
    rows: pd.DataFrame | None = None,
    *,
    folder: Path | str = RESULTS,
    metric: str = "psnr",
    device: str = "",
) -> Comparison:
    """Whether row `first` of the results leads row `second`, and how sure that is.

    `rows` are results as `run` returns them; by default those in `folder` are read. The answer has
    the paired difference of each budget with its interval. Raises RlbenchError for a row that the
    results do not have.
    """
    from reports.compare import compare as compare_rows
    from rlbench.benchmark.results import read

    table = read(Path(folder)) if rows is None else rows
    return compare_rows(
        select_methods(table, [first, second], Path(folder)), first, second, metric, device
    )


def select_methods(table: pd.DataFrame, methods: Collection[str], results: Path) -> pd.DataFrame:
    """The rows of methods, given by names in the table or by patterns of installed methods.

    Raises OptionError for a name without rows, and PluginError for a name that is neither in the
    table nor installed.
    """
    from rlbench import registry
    from rlbench.benchmark.results import RowName
    from rlbench.benchmark.results import select_methods as are_of

    available = set(table["method"])  # also of plugins that are not loaded now
    exact = [name for name in methods if RowName.parse(name).label or name in available]
    patterns = [name for name in methods if name not in exact]
    rows = table[are_of(table, exact + registry.expand(patterns, pretrained_only=False))]
    single = [n for n in methods if n.partition("/")[0] != "all" and not n.endswith("/*")]
    missing = [name for name in single if not are_of(table, [name]).any()]
    if missing or rows.empty:
        names = missing or list(methods)
        problem = f"{results} has no rows of {', '.join(names)}"
        raise OptionError(unknown_name(problem, names[0], sorted(available)))
    return rows


def _read_times(cost: str, rows: pd.DataFrame) -> GivenTimes:
    """The times of a cost profile at its own size, for the rows of the results."""
    from reports.decide import GivenTimes
    from rlbench.benchmark.cost_profile import read_profile

    times = read_profile(cost)
    found = {name: times.inference(name, times.height, times.width) for name in set(rows["method"])}
    inference = {name: each.ms for name, each in found.items() if each}
    size = f"{times.width}x{times.height}"
    return GivenTimes(times.device, size, times.source, times.default_ms, inference)
