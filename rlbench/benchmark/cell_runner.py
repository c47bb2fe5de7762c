"""Scores and times of one cell: the part of a run that a worker does."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch

from rlbench import registry
from rlbench.benchmark import cost, latency
from rlbench.benchmark.cell_ids import CellIds
from rlbench.benchmark.cell_images import CellImages, KeptFrame
from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.clip_sources import samples_at_cap
from rlbench.benchmark.ground_truth_cache import GroundTruthCache, buffers_of_truth
from rlbench.benchmark.resolve import ResolvedCell
from rlbench.benchmark.results import CellKey, Row
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.scoring import (
    add_counts,
    count_rows,
    refusal_row,
    row_template,
    score_frames,
)
from rlbench.benchmark.time_rows import drop_times, failed_time_rows, timing_rows
from rlbench.benchmark.timing_cache import TimingCache, TimingCallback
from rlbench.method import Method, config_json
from rlbench.parallel.executor import Executor, JobResult, ProgressCallback, Resources
from rlbench.run import run_clip
from rlbench.system.process_settings import keep_freed_memory
from rlbench.training.dataset import QUICK_PREFIX, QUICK_REMARK

__all__ = ["CellOutput", "CellRunner"]

StoredRows = Mapping[CellKey, Sequence[Row]]  # of cells that keep their scores


class CellOutput(NamedTuple):
    """All rows of a cell, and its images where they are kept."""

    rows: list[Row]
    images: CellImages | None = None
    failure: str = ""  # the reason, where an error left the cell without scores or times


class CellRunner:
    """Measures the cells of one plan; every worker has a copy."""

    def __init__(
        self,
        plan: RunPlan,
        cells: list[ResolvedCell],
        ids: CellIds,
        *,
        keep_images: bool,
        scores_only: bool,
    ) -> None:
        """Load the metrics and prepare a row of each cell."""
        self.plan = plan
        self.keep_images = keep_images
        self.scores_only = scores_only
        self.metrics = list(registry.load_run_metrics().values())
        self.truths = GroundTruthCache(self.metrics[0])
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
        timed = [] if self.scores_only else cells
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

    def __call__(self, cell: ResolvedCell, on_progress: ProgressCallback) -> CellOutput:
        """Scores of each frame, then times; or one row with the reason why there are none."""
        keep_freed_memory()
        if reason := self.loader.incompatibility(cell):
            return CellOutput([refusal_row(self.templates[cell.key], reason)])
        return self._measure(cell, self.loader.method(cell))

    def failure(self, cell: ResolvedCell, error: Exception) -> CellOutput:
        """The output of a cell that an error stopped: one row with the reason."""
        reason = registry.failure_reason(cell.method.name, error)
        return CellOutput([refusal_row(self.templates[cell.key], reason)], failure=reason)

    def _measure(self, cell: ResolvedCell, method: Method) -> CellOutput:
        clip = self.truths.open(self.loader.clip(cell, buffers_of_truth(self.metrics)))
        template = replace(self.templates[cell.key], config=config_json(method))
        remarks, rows, frames = self._remarks(cell), [], []
        max_samples = samples_at_cap(cell.traits, cell.pool_spp)
        pixels = torch.zeros(max_samples + 1, dtype=torch.long)
        results = run_clip(method, clip, cell.target_spp)
        for result, scored in score_frames(
            template, self.metrics, results, cell.header, clip.ground_truth, max_samples
        ):
            rows += [replace(row, note=row.note or remarks) for row in scored]
            pixels = add_counts(pixels, result.samples.counts)
            frames += [KeptFrame.of(result)] if self.keep_images else []
        rows += count_rows(template, pixels)
        shared = cell.traits.pool, clip.digest, max_samples
        images = CellImages(*shared, frames) if self.keep_images else None
        return CellOutput(rows + self._time_rows(cell, template, rows), images)

    def _with_new_times(
        self, cell: ResolvedCell, rows: Sequence[Row], error: Exception | None
    ) -> CellOutput:
        """The stored scores of a cell with new times, or with the reason why it has none."""
        if self.loader.incompatibility(cell):
            return CellOutput(list(rows))
        scores = drop_times(rows)
        template = replace(self.templates[cell.key], config=scores[0].config)
        if error:
            reason = registry.failure_reason(cell.method.name, error)
            return CellOutput(scores + failed_time_rows(template, reason), failure=reason)
        return CellOutput(scores + self._time_rows(cell, template, scores))

    def _time_rows(self, cell: ResolvedCell, template: Row, scores: Sequence[Row]) -> list[Row]:
        if self.scores_only:
            return []
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
        if any(name.startswith(QUICK_PREFIX) for name in cell.method.training_clips):
            remarks.append(QUICK_REMARK)
        here = latency.device_name(self.plan.device)
        if here != cell.key.device:  # this worker is another machine than the rows name
            remarks.append(f"scored on {here}")
        return "; ".join(remarks)
