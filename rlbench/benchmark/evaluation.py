"""Scores kept images again, by any metric and convention, without running a method.

Each cell and metric is a file in a results folder of its own, RESULTS/evaluated, with the rows of a
run but for metric, value and convention. A cell and metric that are there already, with the same
images and code, are not scored again. An error of a metric is a row with the reason, and the next
evaluation tries it again.
"""

from __future__ import annotations

import importlib.metadata
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import torch

from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.cell_images import KeptCell
from rlbench.benchmark.cell_key import FAILED, CellId
from rlbench.benchmark.results import UNFINISHED, WHOLE_CLIP, Row
from rlbench.benchmark.scoring import (
    buffers_of_truth,
    compare_frame,
    make_ground_truth,
    refusal_row,
    results_of_images,
    score_clip,
    score_frame,
)
from rlbench.clips.stored import open_clip
from rlbench.errors import OptionError
from rlbench.run import FrameResult
from rlbench.system import provenance
from rlbench.system.folder_lock import locked_folder
from rlbench.system.store import write_text

if TYPE_CHECKING:
    from metrics.comparison import Comparison
    from metrics.metric import Metric

SCORING = ("rlbench.benchmark.evaluation", "rlbench.benchmark.scoring")  # images to numbers
OF_RUNS = "srgb"  # the convention in which a run scores


@dataclass(frozen=True)
class EvaluationSummary:
    """Number of pairs of a cell and a metric by what happened to them."""

    scored: int = 0
    cached: int = 0  # in the results already
    failures: tuple[str, ...] = ()  # cell, metric and reason of each that an error stopped


def evaluate(
    folder: Path,
    cells: Sequence[KeptCell],
    metrics: Sequence[EvaluatedMetric],
    out: Path,
    on_cell: Callable[[KeptCell], None] = lambda kept: None,
) -> EvaluationSummary:
    """Score the images of `cells`, in the results `folder`, and write rows into the folder `out`.

    Older scores of the same cells are removed. `on_cell` is called with each finished cell. Raises
    KeptImagesError for damaged images, TableError for results that cannot be used, and
    FolderInUseError where another process writes to `out`.
    """
    with locked_folder(out):
        write_text(out / UNFINISHED, "")
        summary = _evaluate(folder, cells, metrics, out, on_cell)
        (out / UNFINISHED).unlink()
        return summary


def _evaluate(
    folder: Path,
    cells: Sequence[KeptCell],
    metrics: Sequence[EvaluatedMetric],
    out: Path,
    on_cell: Callable[[KeptCell], None],
) -> EvaluationSummary:
    results.set_aside_damaged(out)
    stored = results.cells(out)
    scored, cached, failures = 0, 0, []
    for kept in cells:
        ids = {
            each: CellId(
                replace(kept.cell.key, metric=each.name),
                f"{kept.cell.content_hash}-{each.content_hash}",
            )
            for each in metrics
        }
        due, current = [each for each in metrics if ids[each] not in stored], set(ids.values())
        cached += len(metrics) - len(due)
        for each, rows, reason in _score_cell(kept, due, _template(folder, kept.cell)):
            cell = replace(ids[each], content_hash=FAILED) if reason else ids[each]
            results.write_cell(out, cell, rows)
            current.add(cell)  # a failure has the file of the failure before
            failures += [f"{cell.key}: {reason}"] if reason else []
            scored += not reason
        for older in _outdated(stored, kept.cell, current):
            results.drop_cell(out, older)
        on_cell(kept)
    return EvaluationSummary(scored, cached, tuple(failures))


def _outdated(
    stored: Collection[CellId], cell: CellId, current: Collection[CellId]
) -> list[CellId]:
    """The stored scores of a cell's older images, or by older code of the `current` metrics."""
    metrics = {each.key.metric for each in current}
    same_slot = [s for s in stored if replace(s.key, metric="").slot == cell.key.slot]
    return [
        s
        for s in same_slot
        if s not in current
        and (s.key.metric in metrics or not s.content_hash.startswith((cell.content_hash, FAILED)))
    ]


def _template(folder: Path, cell: CellId) -> Row:
    """A row of the run's cell with its remarks, and the samples of the mean frame."""
    rows = results.read_cell_rows(folder, cell)
    frames = [row for row in rows if row.metric == "psnr" and row.frame != WHOLE_CLIP]
    mean_spp = sum(row.mean_spp for row in frames) / len(frames)
    return replace(frames[0], frame=WHOLE_CLIP, value=math.nan, mean_spp=mean_spp)


def _score_cell(
    kept: KeptCell, metrics: Sequence[EvaluatedMetric], template: Row
) -> Iterator[tuple[EvaluatedMetric, list[Row], str]]:
    """The rows of each metric and no reason; or one row, and the reason that it names."""
    if not metrics:
        return
    rows: dict[EvaluatedMetric, list[Row]] = {each: [] for each in metrics}
    reasons: dict[EvaluatedMetric, str] = {}
    whole_clip = [each for each in metrics if each.metric.whole_clip]
    comparisons: list[Comparison] = []
    for result, compared in _compare_frames(kept, metrics):
        comparisons += [compared] if whole_clip else []
        for each in metrics:
            if each not in whole_clip and each not in reasons:
                with _reason_in(reasons, each):
                    scored = score_frame(template, [each.metric], compared, result, kept.header)
                    rows[each] += scored
    for each in whole_clip:
        with _reason_in(reasons, each):
            rows[each].append(score_clip(template, each.metric, comparisons, kept.header))
    for each in metrics:
        if reason := reasons.get(each, ""):
            yield each, [replace(refusal_row(template, reason), metric=each.name)], reason
        else:
            remarked = [replace(row, note=row.note or template.note) for row in rows[each]]
            yield each, remarked, ""


@contextmanager
def _reason_in(reasons: dict[EvaluatedMetric, str], metric: EvaluatedMetric) -> Iterator[None]:
    """Whatever a metric may raise is the reason why the cell has no score of it."""
    try:
        with registry.exits_as_errors():
            yield
    except Exception as error:
        reasons[metric] = f"{type(error).__name__}: {error}"


def _compare_frames(
    kept: KeptCell, metrics: Sequence[EvaluatedMetric]
) -> Iterator[tuple[FrameResult, Comparison]]:
    """Each frame as a run would have handed it to metrics; no sample is read from the clip."""
    inputs = buffers_of_truth(each.metric for each in metrics) & set(kept.header.buffers)
    clip = open_clip(kept.clip.folder, inputs, max_samples=1, pool=kept.images.pool)
    metric, compared = metrics[0].metric, None
    stored = map(kept.images.frame, range(len(kept.images)))
    images = (
        (torch.from_numpy(image).float(), torch.from_numpy(counts).float())
        for image, counts in stored
    )
    for result in results_of_images(clip, images):
        truth = make_ground_truth(metric, result.frame)
        compared = compare_frame(metric, result, truth, compared, kept.images.max_samples)
        yield result, compared


class EvaluatedMetric(NamedTuple):
    """A metric under one convention, and a hash of what its scores depend on beside the images."""

    metric: Metric
    content_hash: str

    @property
    def name(self) -> str:
        """The name of its rows, such as psnr or psnr@hable."""
        return self.metric.name


def select_metrics(names: Iterable[str], conventions: Iterable[str] = ()) -> list[EvaluatedMetric]:
    """The named metrics; those that take a convention, under each of `conventions`.

    Without conventions, and under srgb, each metric is as a run scores it. Raises PluginError for
    an unknown metric and for one whose package is not installed, and OptionError for a convention
    that is unknown or that none of the metrics takes.
    """
    loaded = {name: load_metric(name) for name in dict.fromkeys(names)}
    requested = list(dict.fromkeys(conventions))
    if requested and not any(metric.takes_convention for metric in loaded.values()):
        raise OptionError(
            f"--convention {','.join(requested)}: {', '.join(loaded)} takes no convention. Omit "
            "it, or add a metric such as psnr"
        )
    return [
        EvaluatedMetric(metric, _content_hash(name, metric))
        for name, plain in loaded.items()
        for metric in _variants(plain, requested)
    ]


def _variants(metric: Metric, conventions: Sequence[str]) -> list[Metric]:
    """The metric under each convention, if it takes one and there are any; else as it is.

    Under that of runs it has its plain name.
    """
    if not conventions or not metric.takes_convention:
        return [metric]
    variants = []
    for convention in conventions:
        try:
            variants.append(metric if convention == OF_RUNS else metric.under(convention))
        except ValueError as error:
            raise OptionError(f"--convention {convention}: {error}") from error
    return variants


def load_metric(name: str) -> Metric:
    """A metric by name. Raises PluginError for an unknown one, and where its package is missing."""
    metric: Metric = registry.load_or_explain("metrics", name)
    if missing := provenance.missing_packages(metric.requires):
        raise registry.PluginError(
            f"metric '{name}' needs {', '.join(missing)}, which is not installed: pip install "
            f"{_extra_with(missing[0]) or ' '.join(missing)}"
        )
    return metric


def _content_hash(entry: str, metric: Metric) -> str:
    """Hash of a metric's code, convention and packages, and of the code that scores images."""
    code = registry.metrics_code_hash([entry], SCORING)
    content = (metric.name, metric.convention, code, provenance.package_versions(metric.requires))
    return sha256(repr(content).encode()).hexdigest()[:16]


def _extra_with(package: str) -> str:
    """The extra of rlbench that installs a package, as pip reads it; empty without one.

    >>> _extra_with("numcodecs")
    "'rlbench[noisebase]'"
    """
    for line in importlib.metadata.requires("rlbench") or ():
        match = re.match(rf"{re.escape(package)}\b.*extra == ['\"](\w+)['\"]", line)
        if match and match[1] != "dev":
            return f"'rlbench[{match[1]}]'"
    return ""
