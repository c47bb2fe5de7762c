"""The runner: measures the cells of a plan and writes each when it is done.

The times of all missing cells are measured first, together; then their scores, cell by cell. Cells
that are in the results already are not run again, so a killed run resumes where it stopped. A cell
whose content has changed (code, weights, clip) replaces its older version, so that a results
folder holds one answer for each method, clip, budget, seed and device. A cell whose times alone
are out of date (cost of a sample, clock) is timed again and keeps its scores. A cell that cannot
run is one row with the reason; if the reason was an error, the next run tries the cell again.
Where an error stopped only its times, its scores stay. A damaged row file is set aside, and its
cell counts as missing.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rlbench.benchmark import results
from rlbench.benchmark.cell_ids import CellIds
from rlbench.benchmark.cell_key import CellsError, check_no_overwrite
from rlbench.benchmark.cell_runner import CellOutput, CellRunner
from rlbench.benchmark.cell_store import CellStore
from rlbench.benchmark.looks import record_looks
from rlbench.benchmark.preflight import check_times_alone
from rlbench.benchmark.resolve import ResolvedCell, resolve_cells
from rlbench.benchmark.results import CellId, CellKey
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.timing_cache import TimingCallback
from rlbench.parallel.executor import LOCAL, Executor
from rlbench.system.folder_lock import locked_folder
from rlbench.system.paths import WriteError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CellCallback", "ProgressCallbacks", "RunSummary", "measure", "read_cells"]

CellCallback = Callable[[ResolvedCell], None]

_logger = logging.getLogger(__name__)


def _ignore(cell: ResolvedCell) -> None:
    pass


def _ignore_timing(done: int, total: int) -> None:
    pass


class ProgressCallbacks(NamedTuple):
    """Callbacks that show how far a run is."""

    on_cell: CellCallback = _ignore  # called with each finished cell
    on_timing: TimingCallback = _ignore_timing  # called with the number of timed rows, and of all


@dataclass(frozen=True)
class RunSummary:
    """Number of cells by what happened to them."""

    measured: int = 0  # with numbers
    skipped: int = 0  # not supported by the method, with the reason instead
    failed: int = 0  # without scores or new times by an error, which is their reason
    cached: int = 0  # in the results already
    timed: int = 0  # in the results already, with new times
    unscored: int = field(default=0, compare=False)  # not in the results, so not timed either
    replaced: int = field(default=0, compare=False)  # older versions, removed
    set_aside: tuple[Path, ...] = field(default=(), compare=False)  # damaged row files, renamed
    failures: tuple[CellKey, ...] = field(default=(), compare=False)  # cells that failed

    def __add__(self, other: RunSummary) -> RunSummary:
        """The counts of two runs together."""
        names = [each.name for each in fields(self)]
        return RunSummary(**{name: getattr(self, name) + getattr(other, name) for name in names})


def measure(
    plan: RunPlan,
    folder: Path,
    on_cell: CellCallback = _ignore,
    executor: Executor = LOCAL,
    on_timing: TimingCallback = _ignore_timing,
    *,
    retime: bool = False,
    scores_only: bool = False,
    keep_images: bool = False,
) -> RunSummary:
    """Measure every cell of `plan` that the results in `folder` do not have, and write its rows.

    A cell whose scores the results have is only timed where its times are out of date; with
    `retime`, all such cells are timed again, and no cell is scored. Scores stay as they are.
    With `scores_only`, nothing is timed: a later call without it measures the times that are
    missing, when the machine is quiet.
    With `keep_images`, the images of each cell are written too (`cell_images`), and a cell whose
    scores the results have without its images is measured again. `on_cell` is called with each
    finished cell, `on_timing` with the number of timed rows.

    Raises, before anything is measured: PluginError for an unknown method, CostError for an
    unknown cost profile, CellsError for clips with the same name, where scores of whole clips or
    of another preset would be lost, or where `retime` finds no cell; OptionError for `retime` with
    `keep_images` or `scores_only`; FolderInUseError where another process writes to `folder`.
    Raises ExecutorError where no cell can be run, and WriteError where the disk is full: what is
    measured by then is kept.
    """
    if retime:
        check_times_alone(scores_only, keep_images)
    plan.check_unique_names()
    cells, ids = resolve_cells(plan), CellIds(plan)
    runner = CellRunner(plan, cells, ids, keep_images=keep_images, scores_only=scores_only)
    with locked_folder(folder):
        return _measure(
            cells, ids, runner, folder, ProgressCallbacks(on_cell, on_timing), executor, retime
        )


def _measure(
    cells: Sequence[ResolvedCell],
    ids: CellIds,
    runner: CellRunner,
    folder: Path,
    progress: ProgressCallbacks,
    executor: Executor,
    retime: bool,
) -> RunSummary:
    """`measure` in a folder that no other process writes to."""
    store, scores_only = CellStore(folder), runner.scores_only
    cell_ids = {cell.key: store.identify(ids.cell_id(cell), scores_only) for cell in cells}
    for cell_id in cell_ids.values():
        check_no_overwrite(cell_id, store.slots)
    stored = {key: store.rows(each, runner.keep_images) for key, each in cell_ids.items()}
    known = {key: rows for key, rows in stored.items() if rows is not None}
    unscored = [cell for cell in cells if cell.key not in known]
    current = {key for key in known if cell_ids[key] in store.cells and not retime}
    due = [cell for cell in cells if cell.key not in current and not (retime and cell in unscored)]
    if retime and not due:
        raise CellsError(
            f"no cell of this run is in {folder} with the scores of today's code, weights and "
            "clips, so there is no time to measure again. Run without --retime"
        )
    summary = RunSummary(set_aside=store.set_aside, unscored=len(unscored) if retime else 0)
    for cell in cells:
        if cell.key in current:
            replaced = store.drop_superseded(cell_ids[cell.key])
            summary += RunSummary(cached=1, replaced=replaced)
            _logger.info("%s: in the results already", cell.key)
            progress.on_cell(cell)
    record_looks(folder, [cell for cell in due if cell.key not in known], ids.code_hashes)
    for outcome in runner.run(due, executor, progress.on_timing, known):
        if isinstance(outcome.error, WriteError):  # a full disk fails every cell after this one
            raise outcome.error
        cell_id, error = cell_ids[outcome.job.key], outcome.error
        output = runner.failure(outcome.job, error) if error else outcome.result()
        counts = _count_cell(cell_id, output, is_timed=cell_id.key in known)
        _log_cell(outcome.job, counts, output)
        if error and store.find(cell_id):  # only the images of these scores are missing
            _logger.warning("%s: no images, its scores stay: %s", cell_id.key, output.failure)
            summary += counts
        else:
            written = _written_id(cell_id, output, is_stopped=error is not None)
            times = store.time_rows(cell_id) if scores_only else []
            replaced = store.write(written, output.rows + times, output.images)
            summary += replace(counts, replaced=replaced)
        progress.on_cell(outcome.job)
    return summary


def _written_id(cell: CellId, output: CellOutput, is_stopped: bool) -> CellId:
    """The identity of what a run found; the next run finds no such scores, or no such times."""
    if is_stopped:
        return cell.failed
    return cell.untimed if output.failure else cell


def _log_cell(cell: ResolvedCell, counts: RunSummary, output: CellOutput) -> None:
    what = next(
        name for name in ("failed", "skipped", "timed", "measured") if getattr(counts, name)
    )
    reason = output.failure or (output.rows[0].note if counts.skipped else "")
    _logger.info("%s: %s%s", cell.key, what, reason and f": {reason}")


def _count_cell(cell: CellId, output: CellOutput, is_timed: bool) -> RunSummary:
    if output.failure:
        return RunSummary(failed=1, failures=(cell.key,))
    if len(output.rows) == 1:
        return RunSummary(skipped=1)
    return RunSummary(timed=1) if is_timed else RunSummary(measured=1)


def read_cells(plan: RunPlan, folder: Path) -> pd.DataFrame:
    """The rows of a plan's cells, of all that `folder` holds, in the format of `results.read`.

    Raises TableError if the folder holds no results.
    """
    table = results.read(folder)
    columns = ["method", "clip", "target_spp", "seed", "device"]
    keys = {tuple(getattr(cell.key, name) for name in columns) for cell in resolve_cells(plan)}
    is_planned = [row in keys for row in table[columns].itertuples(index=False, name=None)]
    return table[is_planned].reset_index(drop=True)
