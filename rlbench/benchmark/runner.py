"""Measuring: methods x clips x budgets x seeds, one cell each, written when it is done.

What is in the results already is not run again, so a run that was killed goes on where it was. A
cell whose content has changed (code, weights, clip, cost) replaces its older self, so that a
results folder holds one answer for each method, clip, budget, seed and device. A cell that cannot
run is one row that says why; where that was an error, it is tried again by the next run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch

from rlbench import registry
from rlbench.benchmark import cost, latency
from rlbench.benchmark import results as table
from rlbench.benchmark.cell_ids import CellIds
from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.latency import Timing
from rlbench.benchmark.results import WHOLE_CLIP, Row
from rlbench.benchmark.run_plan import (
    Cell,
    RunPlan,
    by_title,
    cells,
    check_no_overwrite,
    check_unique_names,
    superseded_cells,
)
from rlbench.benchmark.scoring import _check, _row, _with
from rlbench.benchmark.timing_cache import TimingCache
from rlbench.clips.header import LIMITATIONS, Header
from rlbench.method import Method, config_json
from rlbench.parallel.executor import LOCAL, Executor, JobResult, ProgressCallback, Resources
from rlbench.run import FrameResult, run_clip


@dataclass(frozen=True)
class RunSummary:
    """What became of the cells."""

    measured: int = 0  # with numbers
    skipped: int = 0  # with a reason instead
    cached: int = 0  # in the results already
    replaced: int = field(default=0, compare=False)  # older ones, removed


def measure(
    request: RunPlan,
    results: Path,
    on_cell: Callable[[Cell], None] = lambda cell: None,
    engine: Executor = LOCAL,
    on_timing: Callable[[Cell], None] = lambda cell: None,
) -> RunSummary:
    """Write the rows of every cell that `results` does not have; `tell` hears of each finished one.

    `timed` hears of each whose times were taken before. Raises PluginError for an unknown method,
    CostError for an unknown profile and CellsError for clips that share a name, or where scores of
    whole clips or of another preset's would be lost, before anything is measured; EngineError where
    no cell can be run.
    """
    check_unique_names(request)
    bench = CellRunner(request)
    names = table.cells(results)
    stored = by_title(names)

    def drop(name: str) -> int:
        found = superseded_cells(
            name, stored
        )  # a run killed in between may have left one beside its heir
        for each in found:
            table.drop_cell(results, each)
        return len(found)

    done = RunSummary()
    todo = []
    for cell in cells(request):
        name = bench.names.cell_id(cell)
        check_no_overwrite(name, stored)
        if name in names:
            done = replace(done, cached=done.cached + 1, replaced=done.replaced + drop(name))
            on_cell(cell)
        else:
            todo.append(cell)
    for outcome in bench.outcomes(todo, engine, on_timing):
        cell, name = outcome.job, bench.names.cell_id(outcome.job)
        try:
            rows = outcome.result()
        except Exception as error:  # whatever a stranger's method may raise is what is reported
            name = bench.names.failed(cell)
            rows = [bench.refusal(cell, f"{type(error).__name__}: {error}")]
        table.write_cell(results, name, rows)
        refused = len(rows) == 1
        done = replace(done, measured=done.measured + (not refused), skipped=done.skipped + refused)
        done = replace(done, replaced=done.replaced + drop(name))
        on_cell(cell)
    return done


class CellRunner:
    """What the cells of one request share, and the rows of each."""

    def __init__(self, request: RunPlan) -> None:
        """Load the metrics and resolve the names of the cells."""
        self.request = request
        self.metrics = registry.metrics()
        self.names = CellIds(request)
        self.ready = CellLoader(request)
        profile = None if request.cost == cost.MEASURED else cost.profile(request.cost)
        self.times = TimingCache(self.ready, profile)

    def outcomes(
        self, todo: list[Cell], engine: Executor, timed: Callable[[Cell], None]
    ) -> Iterator[JobResult[Cell, list[Row]]]:
        """The rows of cells as they are done, or the error that stopped them."""
        if not todo:
            return
        self.names = self.names.resolved()
        gpus = 1 if self.request.device.type == "cuda" else 0
        share = Resources(torch.get_num_threads(), gpus)
        untimed = [] if engine.exclusive else self.times.measure_all(todo, engine, share, timed)
        for cell, error in untimed:
            yield JobResult(cell, error=error)
        able = [cell for cell in todo if cell not in [each for each, _ in untimed]]
        yield from engine.map(self, able, share)

    def __call__(self, cell: Cell, tell: ProgressCallback) -> list[Row]:
        """Scores of each frame, then times; or one row that says why there are none."""
        if why := self.ready.unusable(cell):
            return [self.refusal(cell, why)]
        return self._measured(cell, self.ready.method(cell))

    def refusal(self, cell: Cell, why: str) -> Row:
        """The one row of a cell without numbers."""
        return replace(self.row_template(cell), metric="psnr", value=math.nan, note=why)

    def _measured(self, cell: Cell, method: Method) -> list[Row]:
        clip = self.ready.clip(cell)
        blank = replace(self.row_template(cell), config=config_json(method))
        remarks = "; ".join(filter(None, (self.train_test_overlap(cell), self._elsewhere())))
        rows, before = [], None
        for shown in run_clip(method, clip, cell.spp):
            scored = self._scores(blank, shown, before, cell.clip.header)
            rows += [replace(row, note=row.note or remarks) for row in scored]
            before = shown
        bought = sum(row.spp_realised for row in rows) / len(rows)
        times = self.times.of(cell, method, clip)
        return rows + self._timing(replace(blank, spp_realised=bought), times, cell)

    def train_test_overlap(self, cell: Cell) -> str:
        """Why scores of a clip that the weights have seen in training prove nothing, or nothing."""
        clip = cell.clip.header.name
        return (
            f"no test: its weights were trained on {clip}"
            if self.names.trained_on_clip(cell)
            else ""
        )

    def _elsewhere(self) -> str:
        """The device that scores are of, where the results are of another one."""
        here = latency.device_name(self.request.device)
        return "" if here == self.names.device else f"scored on {here}"

    def _scores(
        self, blank: Row, shown: FrameResult, before: FrameResult | None, header: Header
    ) -> Iterator[Row]:
        images = (shown.image, shown.frame.reference.half_a, shown.frame.reference.half_b)
        _check(blank.method, *images[:2])
        bought = float(shown.samples.counts.double().mean())
        for metric in (each.at(*shown.image.shape[-2:]) for each in self.metrics.values()):
            if metric.temporal and before is None:
                continue
            undefined = metric.halves and "halves" in header.limitations
            taken = _with(before, images) if metric.temporal and before else images
            score = math.nan if undefined else float(metric.score(*taken)[0])
            note = LIMITATIONS["halves"] if undefined else ""
            if math.isnan(score) and not undefined:
                note = f"the value is nan: {metric.convention}"
            told = (metric.name, score, metric.unit, metric.better, metric.convention, note)
            yield _row(replace(blank, frame=shown.frame.index, spp_realised=bought), *told)

    def _timing(self, blank: Row, times: Timing, cell: Cell) -> list[Row]:
        price = self.times.cost(cell)
        told = f"{times.inference.n} frames of {times.clip} after {latency.WARM_UP} of warm-up"
        rows = []
        for part in ("plan", "denoise", "buy", "inference"):
            spread = getattr(times, part)
            charged = "" if part != "buy" else ", charged to nobody"
            rows += [
                _row(blank, f"{part}_ms", spread.p50, "ms", "low", f"median of {told}{charged}"),
                _row(blank, f"{part}_p95_ms", spread.p95, "ms", "low", f"p95 of {told}{charged}"),
            ]
        sampling = blank.spp_realised * price.sample_ms
        total, how = times.plan.p50 + times.denoise.p50 + sampling, price.convention
        why = price.note if math.isnan(price.sample_ms) else ""
        return [
            *rows,
            _row(blank, "sample_ms", price.sample_ms, "ms", "low", how, price.note),
            _row(blank, "sampling_ms", sampling, "ms", "low", how, why),
            _row(
                blank,
                "total_ms",
                total,
                "ms",
                "low",
                f"plan p50 + denoise p50 + sampling; {how}",
                why,
            ),
        ]

    def row_template(self, cell: Cell) -> Row:
        """A row of this cell, without a number."""
        header = cell.clip.header
        return Row(
            run=self.names.run,
            method=self.names.method(cell.method),
            clip=header.name,
            scene=header.scene,
            spp=cell.spp,
            spp_realised=math.nan,
            frame=WHOLE_CLIP,
            metric="",
            value=math.nan,
            seed=cell.seed,
            preset=header.preset,
            device=self.names.device,
            dtype="bfloat16" if self.request.runs_in_bf16(cell.method) else "float32",
            code=self.names.code[cell.method],
            weights=self.names.weights[cell.method],
        )
