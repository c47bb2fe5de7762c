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

from rlbench.benchmark import cost, latency
from rlbench.benchmark import results as table
from rlbench.benchmark.cell_ids import Names
from rlbench.benchmark.cell_loader import Ready
from rlbench.benchmark.latency import Timing
from rlbench.benchmark.results import WHOLE_CLIP, Row
from rlbench.benchmark.run_plan import Cell, Request, by_title, cells, distinct, never_lost, older
from rlbench.benchmark.scoring import _check, _row, _with
from rlbench.benchmark.timing_cache import Times
from rlbench.clips.header import LACKS, Header
from rlbench.method import Method, settings
from rlbench.parallel.executor import LOCAL, Engine, Outcome, Share, Tell
from rlbench.registry import lookup as registry
from rlbench.run import Shown, run_clip


@dataclass(frozen=True)
class Done:
    """What became of the cells."""

    measured: int = 0  # with numbers
    refused: int = 0  # with a reason instead
    known: int = 0  # in the results already
    replaced: int = field(default=0, compare=False)  # older ones, removed


def measure(
    request: Request,
    results: Path,
    tell: Callable[[Cell], None] = lambda cell: None,
    engine: Engine = LOCAL,
    timed: Callable[[Cell], None] = lambda cell: None,
) -> Done:
    """Write the rows of every cell that `results` does not have; `tell` hears of each finished one.

    `timed` hears of each whose times were taken before. Raises PluginError for an unknown method,
    CostError for an unknown profile and CellsError for clips that share a name, or where scores of
    whole clips or of another preset's would be lost, before anything is measured; EngineError where
    no cell can be run.
    """
    distinct(request)
    bench = _Bench(request)
    names = table.cells(results)
    stored = by_title(names)

    def drop(name: str) -> int:
        found = older(name, stored)  # a run killed in between may have left one beside its heir
        for each in found:
            table.drop_cell(results, each)
        return len(found)

    done = Done()
    todo = []
    for cell in cells(request):
        name = bench.names.of(cell)
        never_lost(name, stored)
        if name in names:
            done = replace(done, known=done.known + 1, replaced=done.replaced + drop(name))
            tell(cell)
        else:
            todo.append(cell)
    for outcome in bench.outcomes(todo, engine, timed):
        cell, name = outcome.job, bench.names.of(outcome.job)
        try:
            rows = outcome.result()
        except Exception as error:  # whatever a stranger's method may raise is what is reported
            name = bench.names.failed(cell)
            rows = [bench.refusal(cell, f"{type(error).__name__}: {error}")]
        table.write_cell(results, name, rows)
        refused = len(rows) == 1
        done = replace(done, measured=done.measured + (not refused), refused=done.refused + refused)
        done = replace(done, replaced=done.replaced + drop(name))
        tell(cell)
    return done


class _Bench:
    """What the cells of one request share, and the rows of each."""

    def __init__(self, request: Request) -> None:
        self.request = request
        self.metrics = registry.metrics()
        self.names = Names(request)
        self.ready = Ready(request)
        profile = None if request.cost == cost.MEASURED else cost.profile(request.cost)
        self.times = Times(self.ready, profile)

    def outcomes(
        self, todo: list[Cell], engine: Engine, timed: Callable[[Cell], None]
    ) -> Iterator[Outcome[Cell, list[Row]]]:
        """The rows of cells as they are done, or the error that stopped them."""
        if not todo:
            return
        self.names = self.names.settled()
        gpus = 1 if self.request.device.type == "cuda" else 0
        share = Share(torch.get_num_threads(), gpus)
        untimed = [] if engine.alone else self.times.take(todo, engine, share, timed)
        for cell, error in untimed:
            yield Outcome(cell, error=error)
        able = [cell for cell in todo if cell not in [each for each, _ in untimed]]
        yield from engine.map(self, able, share)

    def __call__(self, cell: Cell, tell: Tell) -> list[Row]:
        """Scores of each frame, then times; or one row that says why there are none."""
        if why := self.ready.unusable(cell):
            return [self.refusal(cell, why)]
        return self._measured(cell, self.ready.method(cell))

    def refusal(self, cell: Cell, why: str) -> Row:
        """The one row of a cell without numbers."""
        return replace(self._blank(cell), metric="psnr", value=math.nan, note=why)

    def _measured(self, cell: Cell, method: Method) -> list[Row]:
        clip = self.ready.clip(cell)
        blank = replace(self._blank(cell), config=settings(method))
        remarks = "; ".join(filter(None, (self._leak(cell), self._elsewhere())))
        rows, before = [], None
        for shown in run_clip(method, clip, cell.spp):
            scored = self._scores(blank, shown, before, cell.clip.header)
            rows += [replace(row, note=row.note or remarks) for row in scored]
            before = shown
        bought = sum(row.spp_realised for row in rows) / len(rows)
        times = self.times.of(cell, method, clip)
        return rows + self._timing(replace(blank, spp_realised=bought), times, cell)

    def _leak(self, cell: Cell) -> str:
        """Why scores of a clip that the weights have seen in training prove nothing, or nothing."""
        clip = cell.clip.header.name
        return f"no test: its weights were trained on {clip}" if self.names.seen(cell) else ""

    def _elsewhere(self) -> str:
        """The device that scores are of, where the results are of another one."""
        here = latency.device_name(self.request.device)
        return "" if here == self.names.device else f"scored on {here}"

    def _scores(
        self, blank: Row, shown: Shown, before: Shown | None, header: Header
    ) -> Iterator[Row]:
        images = (shown.image, shown.frame.reference.a, shown.frame.reference.b)
        _check(blank.method, *images[:2])
        bought = float(shown.samples.counts.double().mean())
        for metric in (each.at(*shown.image.shape[-2:]) for each in self.metrics.values()):
            if metric.temporal and before is None:
                continue
            undefined = metric.halves and "halves" in header.lacks
            taken = _with(before, images) if metric.temporal and before else images
            score = math.nan if undefined else float(metric.score(*taken)[0])
            note = LACKS["halves"] if undefined else ""
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

    def _blank(self, cell: Cell) -> Row:
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
            dtype="bfloat16" if self.request.halves(cell.method) else "float32",
            code=self.names.code[cell.method],
            weights=self.names.weights[cell.method],
        )
