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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, get_args

import torch

from rlbench import registry
from rlbench.benchmark import cell_images, cost, latency, results
from rlbench.benchmark.cell_images import CellImages, KeptFrame
from rlbench.benchmark.cell_key import (
    CellId,
    CellKey,
    CellsError,
    by_slot,
    check_no_overwrite,
    superseded_cells,
)
from rlbench.benchmark.clip_sources import samples_at_cap
from rlbench.benchmark.content_hash import CellIds
from rlbench.benchmark.cost_profile import MEASURED, read_profile
from rlbench.benchmark.looks import record_looks
from rlbench.benchmark.results import WHOLE_CLIP, Row
from rlbench.benchmark.run_options import AGAIN, Times
from rlbench.benchmark.run_plan import Cell, CellLoader, RunPlan, list_cells
from rlbench.benchmark.scoring import (
    GroundTruthCache,
    add_counts,
    buffers_of_truth,
    count_rows,
    memory_rows,
    refusal_row,
    row_template,
    score_frames,
)
from rlbench.benchmark.timing import (
    TimingCache,
    TimingCallback,
    drop_times,
    failed_time_rows,
    timing_rows,
)
from rlbench.clips.procedural.folder import QUICK_PREFIX, QUICK_REMARK
from rlbench.errors import OptionError
from rlbench.method import Method, config_json
from rlbench.parallel.executor import LOCAL, Executor, JobResult, ProgressCallback, Resources
from rlbench.recorded_method import find_refusal
from rlbench.registry.near_names import unknown_name
from rlbench.run import run_clip
from rlbench.system.folder_lock import locked_folder
from rlbench.system.half_precision import half_dtype
from rlbench.system.paths import WriteError
from rlbench.system.process_settings import keep_freed_memory

if TYPE_CHECKING:
    import pandas as pd

CellCallback = Callable[[Cell], None]

_logger = logging.getLogger(__name__)


def _ignore(*arguments: object) -> None:
    pass


class ProgressCallbacks(NamedTuple):
    """Callbacks that show how far a run is."""

    on_cell: CellCallback = _ignore  # called with each finished cell
    on_timing: TimingCallback = _ignore  # called with the number of timed rows, and of all


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
    on_timing: TimingCallback = _ignore,
    *,
    times: Times = "missing",
    keep_images: bool = False,
) -> RunSummary:
    """Measure every cell of `plan` that the results in `folder` do not have, and write its rows.

    A cell whose scores the results have is only timed where its `times` are "missing" or out of
    date. With "again", all such cells are timed again, and no cell is scored; with "uncertain",
    those whose times are, after the time of a sample of clips whose own is. Scores stay as they
    are. With "none", nothing is timed: a later call measures the times that are missing, when the
    machine is quiet.
    With `keep_images`, the images of each cell are written too (`cell_images`), and a cell whose
    scores the results have without its images is measured again. `on_cell` is called with each
    finished cell, `on_timing` with the number of timed rows.

    Raises, before anything is measured: PluginError for an unknown method, CostError for an
    unknown cost profile, CellsError for clips with the same name, where scores of whole clips or
    of another preset would be lost, or where no cell can be timed again; OptionError for
    `keep_images` with times that are measured again; FolderInUseError where another process writes
    to `folder`.
    Raises ExecutorError where no cell can be run, and WriteError where the disk is full: what is
    measured by then is kept.
    """
    check_times(times, keep_images)
    plan.check_unique_names()
    if times == "uncertain" and plan.cost == MEASURED:
        plan = replace(plan, clips=tuple(map(cost.with_certain_sample, plan.clips)))
    runner = CellRunner(plan, times, keep_images=keep_images)
    with locked_folder(folder):
        return _measure(runner, CellStore(folder), on_cell, executor, on_timing)


def _measure(
    runner: CellRunner,
    store: CellStore,
    on_cell: CellCallback,
    executor: Executor,
    on_timing: TimingCallback,
) -> RunSummary:
    """`measure` in a folder that no other process writes to."""
    times, times_alone = runner.times, runner.times in AGAIN
    ids = {key: store.identify(each, times) for key, each in runner.ids.items()}
    for cell_id in ids.values():
        check_no_overwrite(cell_id, store.slots)
    stored = {key: store.rows(each, runner.keep_images) for key, each in ids.items()}
    known = {key: rows for key, rows in stored.items() if rows is not None}
    unscored = [cell for cell in runner.cells if cell.key not in known]
    again = {
        key
        for key, rows in known.items()
        if times == "again" or times == "uncertain" and _is_uncertain(rows)
    }
    current = {key for key in known if ids[key] in store.cells and key not in again}
    due = [cell for cell in runner.cells if cell.key not in current]
    due = [cell for cell in due if not (times_alone and cell in unscored)]
    if times_alone and not known:
        raise CellsError(
            f"no cell of this run is in {store.folder} with the scores of today's code, weights "
            f"and clips, so there is no time to measure again. Run without --times {times}"
        )
    summary = RunSummary(set_aside=store.set_aside, unscored=len(unscored) if times_alone else 0)
    for cell in runner.cells:
        if cell.key in current:
            summary += RunSummary(cached=1, replaced=store.drop_superseded(ids[cell.key]))
            _logger.info("%s: in the results already", cell.key)
            on_cell(cell)
    record_looks(
        store.folder,
        [(each.key, runner.templates[each.key].code_hash) for each in due if each in unscored],
    )
    for outcome in runner.run(due, executor, on_timing, known):
        if isinstance(outcome.error, WriteError):  # a full disk fails every cell after this one
            raise outcome.error
        summary += _store(outcome, ids[outcome.job.key], runner, store, outcome.job.key in known)
        on_cell(outcome.job)
    return summary


def _is_uncertain(rows: Sequence[Row]) -> bool:
    """True if a time of these rows has a wide interval, or if they have none."""
    times = [row for row in rows if row.unit == "ms"]
    return not times or any(row.note.startswith(results.UNCERTAIN) for row in times)


def _store(
    outcome: JobResult[Cell, CellOutput],
    cell: CellId,
    runner: CellRunner,
    store: CellStore,
    has_scores: bool,
) -> RunSummary:
    """Write what a run found of a cell; where an error stopped it, the next run tries it again."""
    error = outcome.error
    output = runner.failure(outcome.job, error) if error else outcome.result()
    if output.failure:
        what, counts = "failed", RunSummary(failed=1, failures=(cell.key,))
    elif len(output.rows) == 1:
        what, counts = "skipped", RunSummary(skipped=1)
    elif has_scores:
        what, counts = "timed", RunSummary(timed=1)
    else:
        what, counts = "measured", RunSummary(measured=1)
    reason = output.failure or (output.rows[0].note if counts.skipped else "")
    _logger.info("%s: %s%s", cell.key, what, reason and f": {reason}")
    if error and store.find(cell):  # only the images of these scores are missing
        _logger.warning("%s: no images, its scores stay: %s", cell.key, output.failure)
        return counts
    times = store.time_rows(cell) if runner.times == "none" else []
    written = cell.failed if error else cell.untimed if output.failure else cell
    replaced = store.write(written, output.rows + times, output.images)
    return replace(counts, replaced=replaced)


def check_times(times: str, keep_images: bool) -> None:
    """Raise OptionError for an unknown word, and for images of a run that measures times alone."""
    if times not in get_args(Times):
        raise OptionError(unknown_name(f"--times {times}: no such times", times, get_args(Times)))
    if times in AGAIN and keep_images:
        raise OptionError(
            f"--times {times}: it measures times alone, so it makes no images. Omit --keep-images"
        )


def read_cells(plan: RunPlan, folder: Path) -> pd.DataFrame:
    """The rows of a plan's cells, of all that `folder` holds, in the format of `results.read`.

    Raises TableError if the folder holds no results.
    """
    table = results.read(folder)
    columns = ["method", "clip", "target_spp", "seed", "device"]
    keys = {tuple(getattr(cell.key, name) for name in columns) for cell in list_cells(plan)}
    is_planned = [row in keys for row in table[columns].itertuples(index=False, name=None)]
    return table[is_planned].reset_index(drop=True)


StoredRows = Mapping[CellKey, Sequence[Row]]  # of cells that keep their scores


class CellOutput(NamedTuple):
    """All rows of a cell, and its images where they are kept."""

    rows: list[Row]
    images: CellImages | None = None
    failure: str = ""  # the reason, where an error left the cell without scores or times


class CellRunner:
    """Scores and times the cells of one plan; every worker has a copy."""

    def __init__(self, plan: RunPlan, times: Times, *, keep_images: bool) -> None:
        """List the cells with their identities, load the metrics and prepare a row of each cell."""
        self.plan = plan
        self.times = times
        self.keep_images = keep_images
        hashes = CellIds(plan)
        self.cells = hashes.cells
        self.ids = {cell.key: hashes.cell_id(cell) for cell in self.cells}
        half = str(half_dtype(plan.device)).removeprefix("torch.")
        self.templates = {
            cell.key: row_template(
                cell.key,
                cell.header,
                hashes.run_id,
                hashes.code_hashes[cell.method_name],
                hashes.weights_hashes[cell.method_name],
                half if cell.half else "float32",
            )
            for cell in self.cells
        }
        self.metrics = list(registry.load_run_metrics().values())
        self.truths = GroundTruthCache(self.metrics[0])
        self.loader = CellLoader(plan)
        profile = None if plan.cost == MEASURED else read_profile(plan.cost)
        self.timings = TimingCache(self.loader, profile)

    def run(
        self,
        cells: list[Cell],
        executor: Executor,
        on_timing: TimingCallback,
        stored: StoredRows,
    ) -> Iterator[JobResult[Cell, CellOutput]]:
        """The rows of each cell as it is done, or the error that stopped it.

        Cells that have `stored` rows keep their scores and get new times.
        """
        if not cells:
            return
        gpus = 1 if self.plan.device.type == "cuda" else 0
        resources = Resources(torch.get_num_threads(), gpus)
        timed = [] if self.times == "none" else cells
        errors = {
            cell.key: error
            for cell, error in self.timings.measure_all(timed, executor, resources, on_timing)
        }
        unscored = []
        for cell in cells:
            error = errors.get(cell.key)
            if cell.key in stored:
                yield JobResult(cell, self._with_new_times(cell, stored[cell.key], error))
            elif error:
                yield JobResult(cell, error=error)
            else:
                unscored.append(cell)
        yield from executor.map(self, unscored, resources)

    def __call__(self, cell: Cell, on_progress: ProgressCallback) -> CellOutput:
        """Scores of each frame, then times; or one row with the reason why there are none."""
        keep_freed_memory()
        if reason := cell.incompatibility:
            return CellOutput([refusal_row(self.templates[cell.key], reason)])
        method = self.loader.method(cell)
        clip = self.truths.open(self.loader.clip(cell, buffers_of_truth(self.metrics)))
        template = replace(self.templates[cell.key], config=config_json(method))
        rows, frames = [], []
        max_samples = samples_at_cap(cell.traits, cell.pool_spp)
        pixels = torch.zeros(max_samples + 1, dtype=torch.long)
        results = run_clip(method, clip, cell.spp)
        for result, scored in score_frames(
            template, self.metrics, results, cell.header, clip.ground_truth, max_samples
        ):
            rows += scored
            pixels = add_counts(pixels, result.samples.counts)
            frames += [KeptFrame.of(result)] if self.keep_images else []
        remarks = self._remarks(cell, method)  # some show in the frames alone
        rows = [replace(row, note=row.note or remarks) for row in rows]
        if cell.traits.temporal:
            rows += memory_rows(template, registry.load_memory_metrics().values(), rows)
        rows += count_rows(template, pixels)
        images = CellImages(cell.traits.pool, clip.digest, max_samples, frames)
        times = self._time_rows(cell, template, rows)
        return CellOutput(rows + times, images if self.keep_images else None)

    def failure(self, cell: Cell, error: Exception) -> CellOutput:
        """The output of a cell that an error stopped: one row with the reason."""
        reason = registry.failure_reason(cell.method_name, error)
        return CellOutput([refusal_row(self.templates[cell.key], reason)], failure=reason)

    def _with_new_times(
        self, cell: Cell, rows: Sequence[Row], error: Exception | None
    ) -> CellOutput:
        """The stored scores of a cell with new times, or with the reason why it has none."""
        if cell.incompatibility:
            return CellOutput(list(rows))
        scores = drop_times(rows)
        template = replace(self.templates[cell.key], config=scores[0].config)
        if error:
            reason = registry.failure_reason(cell.method_name, error)
            return CellOutput(scores + failed_time_rows(template, reason), failure=reason)
        return CellOutput(scores + self._time_rows(cell, template, scores))

    def _time_rows(self, cell: Cell, template: Row, scores: Sequence[Row]) -> list[Row]:
        if self.times == "none":
            return []
        mean_spp = sum(row.mean_spp for row in scores) / len(scores)
        timings, row = self.timings, replace(template, mean_spp=mean_spp)
        published = timings.published_inference(cell)
        return timing_rows(row, timings.timing(cell), timings.cost(cell), published)

    def _remarks(self, cell: Cell, method: Method) -> str:
        """What to know of all scores of a cell; empty for an ordinary test."""
        remarks = []
        if cell.is_trained_on_clip:
            remarks.append(f"no test: its weights were trained on {cell.header.name}")
        if any(name.startswith(QUICK_PREFIX) for name in cell.training_clips):
            remarks.append(QUICK_REMARK)
        if refusal := find_refusal(method):
            remarks.append(refusal)
        here = latency.device_name(self.plan.device)
        if here != cell.key.device:  # this worker is another machine than the rows name
            remarks.append(f"scored on {here}")
        return "; ".join(remarks)


class CellStore:
    """The cells and images that a results folder held when the run began."""

    def __init__(self, folder: Path) -> None:
        """List the cells of `folder`; damaged row files are set aside."""
        self.folder = folder
        self.set_aside = tuple(results.set_aside_damaged(folder))
        self.cells = results.cells(folder)
        self.slots = by_slot(self.cells)
        self._image_slots = by_slot(images.cell for images in cell_images.list_images(folder))

    def find(self, cell: CellId) -> CellId | None:
        """The stored cell with the same scores, whatever its times, or None."""
        stored = self.slots.get(cell.key.slot, ())
        return next((each for each in stored if each.has_scores_of(cell)), None)

    def identify(self, cell: CellId, times: Times) -> CellId:
        """The identity under which a run looks for a cell and writes it.

        With `times` "none", that of the stored cell with the same scores, so that its times stay.
        """
        return self.find(cell) or cell.untimed if times == "none" else cell

    def rows(self, cell: CellId, with_images: bool = False) -> list[Row] | None:
        """The stored rows of a cell with the same scores, or None.

        None `with_images` if there are scores of frames, but not all their images.
        """
        if (stored := self.find(cell)) is None:
            return None
        rows = results.read_cell_rows(self.folder, stored)
        return None if with_images and self._lacks_images(cell, rows) else rows

    def time_rows(self, cell: CellId) -> list[Row]:
        """The times of the stored cell with the same scores; empty where there are none."""
        rows = self.rows(cell) or []
        scores = set(drop_times(rows))
        return [row for row in rows if row not in scores]

    def write(self, cell: CellId, rows: Sequence[Row], images: CellImages | None) -> int:
        """Write a finished cell, images first; returns how many older versions it replaced."""
        if images:
            cell_images.write_images(self.folder, cell, images)
        results.write_cell(self.folder, cell, rows)
        return self.drop_superseded(cell)

    def drop_superseded(self, cell: CellId) -> int:
        """Remove the older versions of a cell; a kill may have left one beside its successor.

        Images of older content are removed too, those of the same scores are kept.
        """
        superseded = superseded_cells(cell, self.slots)
        for older in superseded:
            results.drop_cell(self.folder, older)
        for older in superseded_cells(cell, self._image_slots):
            if not older.has_scores_of(cell):
                cell_images.drop_images(self.folder, older)
        return len(superseded)

    def _lacks_images(self, cell: CellId, rows: list[Row]) -> bool:
        is_scored = any(row.frame != WHOLE_CLIP for row in rows)
        return is_scored and cell_images.find_images(self.folder, cell) is None
