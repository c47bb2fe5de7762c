"""Measuring: methods x clips x budgets x seeds, one cell each, written when it is done.

What is in the results already is not run again, so a run that was killed goes on where it was. A
cell whose content has changed (code, weights, clip, cost profile) replaces its older self, so that
a results folder holds one answer for each method, clip, budget, seed and device. A cell that
cannot run is one row that says why; where that was an error, it is tried again by the next run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any

from torch import Tensor

from rlbench import cost, latency, provenance, registry, table
from rlbench.cells import Cell, Names, Request, cells, distinct, older
from rlbench.cost import Cost
from rlbench.frames import Clip
from rlbench.header import LACKS, Header
from rlbench.latency import Timing
from rlbench.method import Method
from rlbench.run import Shown, run_clip
from rlbench.source import Short, Source, unusable
from rlbench.table import WHOLE_CLIP, Row


@dataclass(frozen=True)
class Done:
    """What became of the cells."""

    measured: int = 0  # with numbers
    refused: int = 0  # with a reason instead
    known: int = 0  # in the results already
    replaced: int = field(default=0, compare=False)  # older ones, removed


def measure(
    request: Request, results: Path, tell: Callable[[Cell], None] = lambda cell: None
) -> Done:
    """Write the rows of every cell that `results` does not have; `tell` hears of each finished one.

    Raises PluginError for an unknown method, CostError for an unknown profile and CellsError for
    clips that share a name, before anything is measured.
    """
    distinct(request)
    bench = _Bench(request)
    stored = table.cells(results)
    done = Done()
    for cell in cells(request):
        name = bench.names.of(cell)
        if name in stored:
            done = replace(done, known=done.known + 1)
        else:
            try:
                rows = bench.rows(cell)
            except Exception as error:  # whatever a stranger's method may raise is what is reported
                name = bench.names.failed(cell)
                rows = [bench.refusal(cell, f"{type(error).__name__}: {error}")]
            table.write_cell(results, name, rows)
            refused = len(rows) == 1
            done = replace(
                done, measured=done.measured + (not refused), refused=done.refused + refused
            )
        for each in older(name, stored):
            table.drop_cell(results, each)
            stored.remove(each)
            done = replace(done, replaced=done.replaced + 1)
        tell(cell)
    return done


class _Bench:
    """What the cells of one request share: built methods, costs, and times already taken."""

    def __init__(self, request: Request) -> None:
        self.request = request
        self.metrics = registry.metrics()
        self.names = Names(request)
        self.profile = None if request.cost == cost.MEASURED else cost.profile(request.cost)
        self._built: dict[str, Method | Exception] = {}
        self._times: dict[tuple[object, ...], Timing] = {}

    def rows(self, cell: Cell) -> list[Row]:
        """Scores of each frame, then times; or one row that says why there are none."""
        if why := unusable(cell.clip.header, registry.variant(cell.method).traits, cell.spp):
            return [self.refusal(cell, why)]
        return self._measured(cell, self._method(cell.method))

    def refusal(self, cell: Cell, why: str) -> Row:
        """The one row of a cell without numbers."""
        return replace(self._blank(cell), metric="psnr", value=math.nan, note=why)

    def _measured(self, cell: Cell, method: Method) -> list[Row]:
        clip = cell.clip.open(method.traits, cell.spp, cell.seed, self.request.device)
        clip = Short(clip, self.request.frames) if self.request.frames else clip
        blank = replace(self._blank(cell), config=_config(method))
        rows = [
            row
            for shown in run_clip(method, clip, cell.spp)
            for row in self._scores(blank, shown, cell.clip.header)
        ]
        bought = sum(row.spp_realised for row in rows) / len(rows)
        return rows + self._timing(replace(blank, spp_realised=bought), cell, method, clip)

    def _scores(self, blank: Row, shown: Shown, header: Header) -> Iterator[Row]:
        reference = shown.frame.reference
        _check(blank.method, shown.image, reference.a)
        bought = float(shown.samples.counts.double().mean())
        h, w = shown.image.shape[-2:]
        for metric in (each.at(h, w) for each in self.metrics.values()):
            undefined = metric.halves and "halves" in header.lacks
            score = (
                math.nan
                if undefined
                else float(metric.score(shown.image, reference.a, reference.b)[0])
            )
            note = LACKS["halves"] if undefined else ""
            told = (metric.name, score, metric.unit, metric.better, metric.convention, note)
            yield _row(replace(blank, frame=shown.frame.index, spp_realised=bought), *told)

    def _timing(self, blank: Row, cell: Cell, method: Method, clip: Clip) -> list[Row]:
        header = cell.clip.header  # where nothing moves nothing is warped, which takes less time
        key = (cell.method, clip.size, cell.spp, header.static, header.pool_spp, cell.clip.priced)
        if key not in self._times:
            self._times[key] = latency.time_method(method, clip, cell.spp, self.request.repeats)
        times, price = self._times[key], self._cost(cell.clip)
        told = f"{times.inference.n} frames after {latency.WARM_UP} of warm-up"
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

    def _cost(self, clip: Source) -> Cost:
        header = clip.header
        if self.profile:
            return self.profile.cost(header.scene, header.height, header.width)
        return cost.measured(header, provenance.machine().cpu)

    def _method(self, name: str) -> Method:
        if name not in self._built:
            try:
                built = registry.method(name, self.request.device, self.request.weights)
            except Exception as error:  # missing weights or packages: a reason for each cell
                self._built[name] = error
            else:
                self._built[name] = built
        found = self._built[name]
        if isinstance(found, Exception):
            raise found
        return found

    def _blank(self, cell: Cell) -> Row:
        """A row of this cell, without a number."""
        header = cell.clip.header
        return Row(
            run=self.names.run,
            method=cell.method,
            clip=header.name,
            scene=header.scene,
            spp=cell.spp,
            spp_realised=math.nan,
            frame=WHOLE_CLIP,
            metric="",
            value=math.nan,
            seed=cell.seed,
            device=self.names.device,
            dtype="float32",
            code=self.names.code[cell.method],
            weights=self.names.weights[cell.method],
        )


def _row(
    blank: Row, metric: str, value: float, unit: str, better: str, how: str, note: str = ""
) -> Row:
    """A number; one that is not finite is no number, and the note says so."""
    if not math.isfinite(value):
        note, value = note or f"the value is {value}", math.nan
    return replace(
        blank, metric=metric, value=value, unit=unit, better=better, convention=how, note=note
    )


def _check(method: str, image: Tensor, like: Tensor) -> None:
    """Raise PluginError for an image that metrics would broadcast or round without a word."""
    if image.shape != like.shape or image.dtype != like.dtype:
        raise registry.PluginError(
            f"'{method}' returned an image of {image.dtype} {list(image.shape)}, "
            f"wanted {like.dtype} {list(like.shape)}"
        )


def _config(method: Method) -> str:
    """A method's settings as JSON: those of its `config`, if it has one."""
    config: Any = getattr(method, "config", None)
    if not is_dataclass(config) or isinstance(config, type):
        return "{}"
    return json.dumps(asdict(config), default=repr, sort_keys=True)
