"""What the command line shows: progress, tables, findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from rlbench.benchmark import latency, results
from rlbench.benchmark.resolve import ResolvedCell, resolve_cells, resolve_method
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import ProgressCallbacks

if TYPE_CHECKING:
    from rlbench.benchmark.runner import RunSummary

PERIOD = 600.0  # seconds of progress that a guess of the rest looks back on
COLUMNS = {  # of `rlbench list`, in their order
    "methods": ("name", "question", "needs", "spp", "adapts", "weights"),
    "metrics": ("name", "unit", "direction", "convention"),
    "presets": ("name", "height", "width", "frames", "reference_spp", "scenes", "takes", "purpose"),
}


@contextmanager
def progress(request: RunPlan) -> Iterator[ProgressCallbacks]:
    """A bar over the cells of a request, on the error stream."""
    with _bar() as bar:
        task = bar.add_task("measuring", total=len(resolve_cells(request)))

        def tell(cell: ResolvedCell) -> None:
            told = f"{cell.method.name} on {cell.header.name}, {cell.target_spp:g} spp"
            bar.update(task, advance=1, description=told)

        def timed(cell: ResolvedCell) -> None:
            bar.update(task, description=f"timed {cell.method.name}, {cell.target_spp:g} spp")

        yield ProgressCallbacks(tell, timed)


@contextmanager
def training(name: str, frames: int) -> Iterator[Callable[[Any, float], None]]:
    """A bar over the frames that a training sees, on the error stream, and the time left."""
    with _bar() as bar:
        task = bar.add_task(name, total=frames)

        def tell(stands: Any, loss: float) -> None:
            status = f"{name}, {training_status(stands, loss)}"
            bar.update(task, completed=stands.frames_seen, description=status)

        yield tell


def training_status(stands: Any, loss: float) -> str:
    """How a training goes: its loss, the last validation, frames a second."""
    told = [f"loss {loss:.4f}"]
    told += [f"validation {psnr:.2f} dB" for _, psnr in stands.validation_history[-1:]]
    return ", ".join([*told, f"{stands.frames_per_second:.1f} frames/s"])


def done(what: RunSummary, out: Path) -> None:
    """What became of the cells of a run."""
    console = Console()
    if not what.measured + what.skipped:
        console.print(f"nothing to do: all {what.cached} cells are in {out} already")
        return
    told = (
        f"{what.measured} cells measured, {what.cached} known before, {what.skipped} not possible"
    )
    told += f", {what.replaced} older ones replaced" if what.replaced else ""
    console.print(f"{told}; results are in {out}")


def table(request: RunPlan, out: Path, methods: Iterable[str] = ()) -> bool:
    """Mean PSNR and frame time of what was asked for, and why cells have no numbers; are there any?

    `methods` are names in the results that the request does not lead to.
    """
    rows = results.read(out)
    names = [clip.header.name for clip in request.clips]
    called = methods or [resolve_method(request, name).row_name for name in request.methods]
    rows = rows[rows["method"].isin(called) & rows["clip"].isin(names)]
    rows = rows[rows["target_spp"].isin(request.target_spp) & rows["seed"].isin(request.seeds)]
    rows = rows[rows["device"] == latency.device_name(request.device)]
    shown = Table(title=f"mean over {len(names)} clips")
    for column in ("method", "spp", "PSNR dB", "inference ms", "total ms"):
        shown.add_column(column, justify="left" if column == "method" else "right")
    for (method, spp), group in rows.groupby(["method", "target_spp"]):
        means = group.groupby("metric")["value"].mean()
        figures = [means.get(name) for name in ("psnr", "inference_ms", "frame_ms")]
        some = group.loc[(group["metric"] == "psnr") & group["value"].notna(), "clip"].nunique()
        of = f" ({some} of them)" if 0 < some < len(names) else ""
        shown.add_row(f"{method}{of}", f"{spp:g}", *(_figure(value) for value in figures))
    console = Console()
    console.print(shown)
    whole = rows[(rows["frame"] == results.WHOLE_CLIP) & rows["value"].isna()]
    for (method, metric, note), group in whole.groupby(["method", "metric", "note"]):
        if metric in ("psnr", "sample_ms"):
            where = ", ".join(sorted(set(group["clip"])))
            console.print(f"{method}: no {metric} on {where}: {note}", markup=False)
    scored = rows[(rows["metric"] == "psnr") & rows["value"].notna() & (rows["note"] != "")]
    for (method, note), _ in scored.groupby(["method", "note"]):
        console.print(f"{method}: {note}", style="yellow", markup=False)
    return bool(rows["value"].notna().any())


def listed(found: dict[str, list[dict[str, Any]]]) -> None:
    """What is installed, one table a kind; broken plugins below it with their error."""
    console = Console()
    for kind, rows in found.items():
        fine = [row for row in rows if "broken" not in row]
        columns = COLUMNS.get(kind) or tuple(fine[0] if fine else ("name",))
        shown = Table(title=kind, title_justify="left")
        for column in columns:
            copied = column == "name"  # names are there to be copied
            shown.add_column(column, no_wrap=copied, overflow="ellipsis" if copied else "fold")
        for row in fine:
            shown.add_row(*(_told(row[column]) for column in columns))
        console.print(shown)
        for row in rows:
            if "broken" in row:
                told = f"{row['name']} (from {row['from']}) is broken: {row['broken']}"
                console.print(told, style="red", markup=False)


def _bar() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    return Progress(*columns, TimeRemainingColumn(), console=console, speed_estimate_period=PERIOD)


def _figure(value: float | None) -> str:
    return "-" if value is None or value != value else f"{value:.2f}"


def _told(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list) and len(value) == 2 and all(isinstance(v, float) for v in value):
        return f"{value[0]:g} to {value[1]:g}"  # a range
    if isinstance(value, list):
        return " ".join(f"{item:g}" if isinstance(item, float) else str(item) for item in value)
    return str(value)
