"""The runner: measures the cells of a plan and writes each when it is done.

The times of all missing cells are measured first, together; then their scores, cell by cell. Cells
that are in the results already are not run again, so a killed run resumes where it stopped. A cell
whose content has changed (code, weights, clip) replaces its older version, so that a results
folder holds one answer for each method, clip, budget, seed and device. A cell whose times alone
are out of date (cost of a sample, clock) is timed again and keeps its scores. A cell that cannot
run is one row with the reason; if the reason was an error, the next run tries the cell again. A
damaged row file is set aside, and its cell counts as missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import torch

from rlbench import registry
from rlbench.benchmark import cost, latency, results
from rlbench.benchmark.cell_ids import CellIds
from rlbench.benchmark.cell_images import CellImages, KeptFrame
from rlbench.benchmark.cell_key import CellsError, check_no_overwrite
from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.cell_store import CellStore
from rlbench.benchmark.clip_sources import samples_at_cap
from rlbench.benchmark.looks import record_looks
from rlbench.benchmark.resolve import ResolvedCell, resolve_cells
from rlbench.benchmark.results import CellId, CellKey, Row
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.scoring import compare_frame, refusal_row, row_template, score_frame
from rlbench.benchmark.time_rows import drop_times, failed_time_rows, timing_rows
from rlbench.benchmark.timing_cache import TimingCache, TimingCallback
from rlbench.errors import OptionError
from rlbench.method import Method, config_json
from rlbench.parallel.executor import LOCAL, Executor, JobResult, ProgressCallback, Resources
from rlbench.render.presets import is_test_split
from rlbench.run import run_clip

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CellCallback", "ProgressCallbacks", "RunSummary", "measure", "read_cells"]

CellCallback = Callable[[ResolvedCell], None]


StoredRows = Mapping[CellKey, Sequence[Row]]  # of cells that keep their scores


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
    failed: int = 0  # stopped by an error, which is their reason
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
    keep_images: bool = False,
) -> RunSummary:
    """Measure every cell of `plan` that the results in `folder` do not have, and write its rows.

    A cell whose scores the results have is only timed where its times are out of date; with
    `retime`, all such cells are timed again, and no cell is scored. Scores stay as they are.
    With `keep_images`, the images of each cell are written too (`cell_images`), and a cell whose
    scores the results have without its images is measured again. `on_cell` is called with each
    finished cell, `on_timing` with the number of timed rows.

    Raises, before anything is measured: PluginError for an unknown method, CostError for an
    unknown cost profile, CellsError for clips with the same name, where scores of whole clips or
    of another preset would be lost, or where `retime` finds no cell; OptionError for `retime` with
    `keep_images`. Raises ExecutorError where no cell can be run.
    """
    if retime and keep_images:
        raise OptionError(
            "--retime measures times alone, so it makes no images. Use --keep-images without it"
        )
    plan.check_unique_names()
    cells, ids = resolve_cells(plan), CellIds(plan)
    runner = CellRunner(plan, cells, ids, keep_images)
    store = CellStore(folder)
    cell_ids = {cell.key: ids.cell_id(cell) for cell in cells}
    for cell_id in cell_ids.values():
        check_no_overwrite(cell_id, store.slots)
    stored = {key: store.rows(cell_id, keep_images) for key, cell_id in cell_ids.items()}
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
            on_cell(cell)
    if not retime:
        tested = [cell for cell in unscored if is_test_split(cell.header.preset)]
        record_looks(folder, tested, ids.code_hashes)
    for outcome in runner.run(due, executor, on_timing, known):
        if outcome.error:  # whatever a method may raise is reported in its row
            cell_id = ids.failed_id(outcome.job)
            output = CellOutput([runner.failure(outcome.job, outcome.error)])
        else:
            cell_id, output = cell_ids[outcome.job.key], outcome.result()
        counts = _count_cell(cell_id, output.rows, is_timed=cell_id.key in known)
        summary += replace(counts, replaced=store.write(cell_id, *output))
        on_cell(outcome.job)
    return summary


def _count_cell(cell: CellId, rows: Sequence[Row], is_timed: bool) -> RunSummary:
    if cell.is_failed:
        return RunSummary(failed=1, failures=(cell.key,))
    if len(rows) == 1:
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


class CellOutput(NamedTuple):
    """All rows of a cell, and its images where they are kept."""

    rows: list[Row]
    images: CellImages | None = None


class CellRunner:
    """Measures the cells of one plan; every worker has a copy."""

    def __init__(
        self, plan: RunPlan, cells: list[ResolvedCell], ids: CellIds, keep_images: bool
    ) -> None:
        """Load the metrics and prepare a row of each cell."""
        self.plan = plan
        self.keep_images = keep_images
        self.metrics = list(registry.load_run_metrics().values())
        self.loader = CellLoader(plan)
        profile = None if plan.cost == cost.MEASURED else cost.profile(plan.cost)
        self.timings = TimingCache(self.loader, profile)
        codes, weights = ids.code_hashes, ids.weights_hashes
        self.templates = {
            cell.key: row_template(
                cell, ids.run_id, codes[cell.method.name], weights[cell.method.name]
            )
            for cell in cells
        }

    def run(
        self,
        cells: list[ResolvedCell],
        executor: Executor,
        on_timing: TimingCallback,
        stored: StoredRows,
    ) -> Iterator[JobResult[ResolvedCell, CellOutput]]:
        """The rows of each cell as it is done, or the error that stopped it.

        Cells that have `stored` rows keep their scores and get new times.
        """
        if not cells:
            return
        gpus = 1 if self.plan.device.type == "cuda" else 0
        resources = Resources(torch.get_num_threads(), gpus)
        errors = {
            cell.key: error
            for cell, error in self.timings.measure_all(cells, executor, resources, on_timing)
        }
        unscored = []
        for cell in cells:
            error = errors.get(cell.key)
            if cell.key in stored:
                rows = self._with_new_times(cell, stored[cell.key], error)
                yield JobResult(cell, CellOutput(rows))
            elif error:
                yield JobResult(cell, error=error)
            else:
                unscored.append(cell)
        yield from executor.map(self, unscored, resources)

    def __call__(self, cell: ResolvedCell, on_progress: ProgressCallback) -> CellOutput:
        """Scores of each frame, then times; or one row with the reason why there are none."""
        if reason := self.loader.incompatibility(cell):
            return CellOutput([refusal_row(self.templates[cell.key], reason)])
        with registry.exits_as_errors():
            return self._measure(cell, self.loader.method(cell))

    def failure(self, cell: ResolvedCell, error: Exception) -> Row:
        """The only row of a cell that an error stopped."""
        return refusal_row(self.templates[cell.key], f"{type(error).__name__}: {error}")

    def _measure(self, cell: ResolvedCell, method: Method) -> CellOutput:
        needs = frozenset().union(*(metric.needs for metric in self.metrics))
        clip = self.loader.clip(cell, scored_buffers=needs & {"motion"})
        template = replace(self.templates[cell.key], config=config_json(method))
        remarks, rows, frames, compared = self._remarks(cell), [], [], None
        max_samples = samples_at_cap(cell.traits, cell.header.pool_spp)
        for result in run_clip(method, clip, cell.target_spp):
            compared = compare_frame(self.metrics[0].compare, result, compared, max_samples)
            scored = score_frame(template, self.metrics, compared, result, cell.header)
            rows += [replace(row, note=row.note or remarks) for row in scored]
            frames += [KeptFrame.of(result)] if self.keep_images else []
        images = CellImages(cell.traits.pool, clip.digest, frames) if self.keep_images else None
        return CellOutput(rows + self._time_rows(cell, template, rows), images)

    def _with_new_times(
        self, cell: ResolvedCell, rows: Sequence[Row], error: Exception | None
    ) -> list[Row]:
        """The stored scores of a cell with new times, or with the reason why it has none."""
        if self.loader.incompatibility(cell):
            return list(rows)
        scores = drop_times(rows)
        template = replace(self.templates[cell.key], config=scores[0].config)
        if error:
            return scores + failed_time_rows(template, f"{type(error).__name__}: {error}")
        return scores + self._time_rows(cell, template, scores)

    def _time_rows(self, cell: ResolvedCell, template: Row, scores: Sequence[Row]) -> list[Row]:
        mean_spp = sum(row.mean_spp for row in scores) / len(scores)
        times = self.timings
        return timing_rows(
            replace(template, mean_spp=mean_spp),
            times.timing(cell),
            times.cost(cell),
            times.published_inference(cell),
        )

    def _remarks(self, cell: ResolvedCell) -> str:
        """What to know of all scores of a cell; empty for an ordinary test."""
        remarks = []
        if cell.is_trained_on_clip:
            remarks.append(f"no test: its weights were trained on {cell.header.name}")
        here = latency.device_name(self.plan.device)
        if here != cell.key.device:  # this worker is another machine than the rows name
            remarks.append(f"scored on {here}")
        return "; ".join(remarks)
