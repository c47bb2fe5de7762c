"""Output of the commands on the terminal: progress bars, tables, summaries."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from rlbench.benchmark.results import mark_uncertainty
from rlbench.benchmark.run_outcome import RunOutcome
from rlbench.benchmark.run_plan import Cell, RunPlan, list_cells
from rlbench.benchmark.runner import ProgressCallbacks
from rlbench.system.progress import LoggedProgress

if TYPE_CHECKING:
    from rlbench.benchmark.runner import RunSummary
    from rlbench.training import Progress as TrainingProgress

SPEED_PERIOD = 600.0  # seconds of progress from which the remaining time is estimated


@contextmanager
def measuring(plan: RunPlan) -> Iterator[ProgressCallbacks]:
    """A progress bar over the cells of a plan, on the error stream."""
    with _progress_bar() as bar:
        task = bar.add_task("measuring", total=len(list_cells(plan)))

        def on_cell(cell: Cell) -> None:
            status = f"{cell.method_name} on {cell.header.name}, {cell.spp:g} spp"
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
            bar.update(
                task,
                completed=progress.frames_seen,
                total=progress.frames_goal,
                description=status,
            )

        yield on_progress


def training_status(progress: TrainingProgress, loss: float) -> str:
    """Loss, last validation, that of each of several sets, and speed of a training."""
    parts = [f"loss {loss:.4f}"]
    parts += [f"validation {psnr:.2f} dB" for _, psnr in progress.validation_history[-1:]]
    if len(progress.curves) > 1:
        sets = (f"{name} {curve[-1][1]:.2f}" for name, curve in progress.curves.items())
        parts[-1] += f" ({', '.join(sets)})"
    return ", ".join([*parts, f"{progress.frames_per_second:.1f} frames/s"])


@contextmanager
def counting(title: str, total: int) -> Iterator[Callable[[], None]]:
    """A progress bar over things to count, on the error stream."""
    with _progress_bar() as bar:
        task = bar.add_task(title, total=total)
        yield lambda: bar.advance(task)


def print_outcome(outcome: RunOutcome) -> None:
    """Print what happened to the cells of a run, its scores and times, and the verdict."""
    console = Console(markup=False)
    _print_summary(outcome.summary, outcome.folder, console)
    _print_scores(outcome, console)
    for line in outcome.missing:
        console.print(line, markup=False)
    for line in outcome.remarks:
        console.print(line, style="yellow", markup=False, soft_wrap=True)
    for each in outcome.verdict.nonfinite:
        console.print(str(each), style="red", markup=False, soft_wrap=True)
    style = "" if outcome.verdict.has_passed else "red"
    console.print(str(outcome.verdict), style=style, markup=False, soft_wrap=True)


def _print_summary(summary: RunSummary, out: Path, console: Console) -> None:
    for file in summary.set_aside:
        text = f"a damaged row file was set aside as {file}; cells of this run are measured again"
        console.print(text, style="yellow", markup=False, soft_wrap=True)
    if not summary.measured + summary.timed + summary.skipped + summary.failed:
        text = f"nothing to do: all {summary.cached} cells are in {out} already"
        console.print(text, markup=False)
        return
    text = (
        f"{summary.measured} cells measured, {summary.cached} already in the results, "
        f"{summary.skipped} skipped"
    )
    text += f", {summary.timed} timed again" if summary.timed else ""
    text += f", {summary.unscored} without scores and not timed" if summary.unscored else ""
    text += f", {summary.failed} failed" if summary.failed else ""
    text += f", {summary.replaced} older ones replaced" if summary.replaced else ""
    console.print(f"{text}; results are in {out}", markup=False)


def _print_scores(outcome: RunOutcome, console: Console) -> None:
    """Print mean PSNR, with and without the reference's noise, and times of a run's rows."""
    clips = outcome.clips
    table = Table(title="one clip" if clips == 1 else f"mean over {clips} clips")
    for column in ("method", "spp", "PSNR dB", "debiased dB", "inference ms", "frame ms"):
        table.add_column(column, justify="left" if column == "method" else "right")
    for row in outcome.scores:
        part = f" ({row.clips} of them)" if 0 < row.clips < clips else ""
        cells = [
            f"{_format_number(ms)}{mark_uncertainty(share)}"
            for ms, share in (
                (row.inference_ms, row.inference_uncertainty),
                (row.frame_ms, row.frame_uncertainty),
            )
        ]
        scores = map(_format_number, (row.psnr, row.psnr_debiased))
        table.add_row(f"{row.method}{part}", f"{row.spp:g}", *scores, *cells)
    console.print(table)


def _progress_bar() -> LoggedProgress:
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    return LoggedProgress(*columns, TimeRemainingColumn(), speed_estimate_period=SPEED_PERIOD)


def _format_number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
