"""Output of the commands on the terminal: progress bars, tables, summaries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from rlbench.benchmark import latency, results
from rlbench.benchmark.resolve import ResolvedCell, resolve_cells, resolve_method
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.run_verdict import judge_run
from rlbench.benchmark.runner import ProgressCallbacks
from rlbench.system.progress import LoggedProgress

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.runner import RunSummary
    from rlbench.training import Progress as TrainingProgress

__all__ = [
    "counting",
    "measuring",
    "print_scores",
    "print_summary",
    "training",
    "training_status",
]

SPEED_PERIOD = 600.0  # seconds of progress from which the remaining time is estimated


@contextmanager
def measuring(plan: RunPlan) -> Iterator[ProgressCallbacks]:
    """A progress bar over the cells of a plan, on the error stream."""
    with _progress_bar() as bar:
        task = bar.add_task("measuring", total=len(resolve_cells(plan)))

        def on_cell(cell: ResolvedCell) -> None:
            status = f"{cell.method.name} on {cell.header.name}, {cell.target_spp:g} spp"
            bar.update(task, advance=1, description=status)

        def on_timing(done: int, total: int) -> None:
            bar.update(task, description=f"timing, {done} of {total} rows")

        yield ProgressCallbacks(on_cell, on_timing)


@contextmanager
def training(title: str, frames: int) -> Iterator[Callable[[TrainingProgress, float], None]]:
    """A progress bar over the frames of a training, on the error stream."""
    with _progress_bar() as bar:
        task = bar.add_task(title, total=frames)

        def on_progress(progress: TrainingProgress, loss: float) -> None:
            status = f"{title}, {training_status(progress, loss)}"
            bar.update(task, completed=progress.frames_seen, description=status)

        yield on_progress


def training_status(progress: TrainingProgress, loss: float) -> str:
    """Loss, last validation and speed of a training."""
    parts = [f"loss {loss:.4f}"]
    parts += [f"validation {psnr:.2f} dB" for _, psnr in progress.validation_history[-1:]]
    return ", ".join([*parts, f"{progress.frames_per_second:.1f} frames/s"])


@contextmanager
def counting(title: str, total: int) -> Iterator[Callable[[], None]]:
    """A progress bar over things to count, on the error stream."""
    with _progress_bar() as bar:
        task = bar.add_task(title, total=total)
        yield lambda: bar.advance(task)


def print_summary(summary: RunSummary, out: Path) -> None:
    """Print what happened to the cells of a run."""
    console = Console()
    for file in summary.set_aside:
        text = f"a damaged row file was set aside as {file}; cells of this run are measured again"
        console.print(text, style="yellow", markup=False, soft_wrap=True)
    if not summary.measured + summary.timed + summary.skipped + summary.failed:
        console.print(f"nothing to do: all {summary.cached} cells are in {out} already")
        return
    text = (
        f"{summary.measured} cells measured, {summary.cached} already in the results, "
        f"{summary.skipped} skipped"
    )
    text += f", {summary.timed} timed again" if summary.timed else ""
    text += f", {summary.unscored} without scores and not timed" if summary.unscored else ""
    text += f", {summary.failed} failed" if summary.failed else ""
    text += f", {summary.replaced} older ones replaced" if summary.replaced else ""
    console.print(f"{text}; results are in {out}")


def print_scores(
    plan: RunPlan, summary: RunSummary, out: Path, row_names: Iterable[str] = ()
) -> bool:
    """Print mean PSNR and times of a plan, why numbers are missing, and whether the run passed.

    Returns False if a cell failed, an image is not finite, or there are no numbers. `row_names` are
    the methods' names in the results, where they are not those of the plan.
    """
    rows = _planned_rows(plan, results.read(out), row_names)
    clips = len(plan.clips)
    table = Table(title="one clip" if clips == 1 else f"mean over {clips} clips")
    for column in ("method", "spp", "PSNR dB", "inference ms", "frame ms"):
        table.add_column(column, justify="left" if column == "method" else "right")
    for (method, spp), group in rows.groupby(["method", "target_spp"]):
        means = group.groupby("metric")["value"].mean()
        numbers = [means.get(name) for name in ("psnr", "inference_ms", "frame_ms")]
        doubted = set(group.loc[_is_unreliable(group), "metric"])
        marks = ("", *("?" * (name in doubted) for name in ("inference_ms", "frame_ms")))
        scored = group.loc[(group["metric"] == "psnr") & group["value"].notna(), "clip"].nunique()
        part = f" ({scored} of them)" if 0 < scored < clips else ""
        cells = [f"{_format_number(n)}{mark}" for n, mark in zip(numbers, marks, strict=True)]
        table.add_row(f"{method}{part}", f"{spp:g}", *cells)
    console = Console()
    console.print(table)
    _print_notes(rows, console)
    verdict = judge_run(summary, rows)
    style = "" if verdict.has_passed else "red"
    console.print(str(verdict), style=style, markup=False, soft_wrap=True)
    return verdict.has_passed


def _planned_rows(plan: RunPlan, rows: pd.DataFrame, row_names: Iterable[str]) -> pd.DataFrame:
    names = list(row_names) or [resolve_method(plan, name).row_name for name in plan.methods]
    clips = [clip.header.name for clip in plan.clips]
    rows = rows[rows["method"].isin(names) & rows["clip"].isin(clips)]
    rows = rows[rows["target_spp"].isin(plan.target_spp) & rows["seed"].isin(plan.seeds)]
    return rows[rows["device"] == latency.device_name(plan.device)]


def _print_notes(rows: pd.DataFrame, console: Console) -> None:
    """Print why clips have no score or no sample time, and remarks on scores."""
    missing = rows[(rows["frame"] == results.WHOLE_CLIP) & rows["value"].isna()]
    for (method, metric, note), group in missing.groupby(["method", "metric", "note"]):
        if metric in ("psnr", "sample_ms"):
            clips = ", ".join(sorted(set(group["clip"])))
            console.print(f"{method}: no {metric} on {clips}: {note}", markup=False)
    _print_unreliable(rows, console)
    scored = rows[(rows["metric"] == "psnr") & rows["value"].notna() & (rows["note"] != "")]
    for (method, note), _ in scored.groupby(["method", "note"]):
        console.print(f"{method}: {note}", style="yellow", markup=False)


def _print_unreliable(rows: pd.DataFrame, console: Console) -> None:
    """Print how many rows have unreliable times, and the first reason."""
    frames = rows[(rows["metric"] == "frame_ms") & _is_unreliable(rows)]
    cells = frames[["method", "target_spp"]].drop_duplicates()
    if len(cells):
        reason = frames["note"].iloc[0].removeprefix(results.UNRELIABLE).strip()
        text = (
            f"{len(cells)} rows have unreliable times, marked ?: {reason}. When the machine is "
            "idle, repeat the command with --retime"
        )
        console.print(text, style="yellow", markup=False, soft_wrap=True)


def _is_unreliable(rows: pd.DataFrame) -> pd.Series[bool]:
    return rows["note"].str.startswith(results.UNRELIABLE)


def _progress_bar() -> LoggedProgress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    return LoggedProgress(*columns, TimeRemainingColumn(), speed_estimate_period=SPEED_PERIOD)


def _format_number(value: float | None) -> str:
    return "-" if value is None or value != value else f"{value:.2f}"
