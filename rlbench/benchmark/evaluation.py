"""Scores kept images again, by any metric and convention, without running a method.

Each cell and metric is a file in a results folder of its own, RESULTS/evaluated, with the rows of a
run but for metric, value and convention. A cell and metric that are there already, with the same
images and code, are not scored again. An error of a metric is a row with the reason, and the next
evaluation tries it again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch

from rlbench import registry
from rlbench.benchmark import cell_images, results
from rlbench.benchmark.cell_images import KeptImages
from rlbench.benchmark.cell_key import FAILED, CellId
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.evaluated_metrics import EvaluatedMetric
from rlbench.benchmark.ground_truth_cache import buffers_of_truth, make_ground_truth
from rlbench.benchmark.results import WHOLE_CLIP, Row
from rlbench.benchmark.scoring import compare_frame, refusal_row, score_clip, score_frame
from rlbench.clips.header import Header
from rlbench.clips.stored import open_clip
from rlbench.errors import RlbenchError
from rlbench.frames import Samples, StoredPool
from rlbench.run import FrameResult
from rlbench.system.folder_lock import locked_folder

__all__ = [
    "EvaluationError",
    "EvaluationSummary",
    "KeptCell",
    "evaluate",
    "find_kept_cells",
    "image_pools",
]


class EvaluationError(RlbenchError, ValueError):
    """Images that cannot be scored: there are none, or they show another clip."""


class KeptCell(NamedTuple):
    """A finished cell of a run whose images were kept."""

    cell: CellId
    images: KeptImages
    clip: StoredSource

    @property
    def header(self) -> Header:
        """The header of the clip."""
        return self.clip.header


@dataclass(frozen=True)
class EvaluationSummary:
    """Number of pairs of a cell and a metric by what happened to them."""

    scored: int = 0
    cached: int = 0  # in the results already
    failures: tuple[str, ...] = ()  # cell, metric and reason of each that an error stopped


def image_pools(folder: Path) -> set[str]:
    """Kinds of the sample pools of all images in a results folder.

    Raises EvaluationError where there is no image.
    """
    pools = {images.pool for images in cell_images.list_images(folder)}
    if not pools:
        problem = "has no images" if folder.is_dir() else "does not exist"
        raise EvaluationError(f"{folder} {problem}; `rlbench run --keep-images` makes them")
    return pools


def find_kept_cells(
    folder: Path, clips: Sequence[StoredSource], methods: Collection[str] = ()
) -> list[KeptCell]:
    """The cells in a results folder with images of `clips`; all `methods`, or those named.

    Raises EvaluationError where there is none, and where a clip has changed since the images.
    """
    by_name = {clip.header.name: clip for clip in clips}
    kept = []
    for cell in sorted(results.cells(folder), key=lambda cell: cell.file_stem):
        is_selected = not methods or cell.key.method in methods
        images = cell_images.find_images(folder, cell)
        if images and is_selected and cell.key.clip in by_name:
            kept.append(KeptCell(cell, images, by_name[cell.key.clip]))
    if not kept:
        keys = [images.cell.key for images in cell_images.list_images(folder)]
        stored_methods, stored_clips = {key.method for key in keys}, {key.clip for key in keys}
        raise EvaluationError(
            f"{folder} has no images of {', '.join(methods) or 'any method'} on "
            f"{', '.join(by_name)}; it has {', '.join(sorted(stored_methods))} on "
            f"{', '.join(sorted(stored_clips))}. `rlbench run --keep-images` makes images"
        )
    for cell, images, clip in kept:
        if (digest := clip.content(images.pool)) != images.clip_digest:
            raise EvaluationError(
                f"the images of '{cell.key}' show a clip with digest {images.clip_digest}, but "
                f"{clip.folder} has {digest}, so its references may be others. Select the clip "
                "of the images, or repeat `rlbench run --keep-images`"
            )
    return kept


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
        return _evaluate(folder, cells, metrics, out, on_cell)


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
        ids = {each: _cell_id(kept, each) for each in metrics}
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


def _cell_id(kept: KeptCell, each: EvaluatedMetric) -> CellId:
    key = replace(kept.cell.key, metric=each.name)
    return CellId(key, f"{kept.cell.content_hash}-{each.content_hash}")


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
    comparisons: list[Any] = []
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
) -> Iterator[tuple[FrameResult, Any]]:
    """Each frame as a run would have handed it to metrics; no sample is read from the clip."""
    inputs = buffers_of_truth(each.metric for each in metrics) & set(kept.header.buffers)
    clip = open_clip(kept.clip.folder, inputs, max_samples=1, pool=kept.images.pool)
    metric, compared = metrics[0].metric, None
    no_samples = torch.zeros(1, 1, 3, kept.header.height, kept.header.width)
    for index in range(len(kept.images)):
        image, counts = (torch.from_numpy(plane).float() for plane in kept.images.frame(index))
        frame = clip.frame_with_pool(index, StoredPool(no_samples, (0,)))
        samples = Samples(no_samples[:, :0], counts.long()[None, None])
        result = FrameResult(frame, samples, image[None], repairs={})
        truth = make_ground_truth(metric, frame)
        compared = compare_frame(metric, result, truth, compared, kept.images.max_samples)
        yield result, compared
