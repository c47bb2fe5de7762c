"""Rows of scores from images, and the ground truth that cells of a clip share.

`timing` adds the rows of times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from rlbench import registry
from rlbench.benchmark.cell_key import CellKey
from rlbench.benchmark.results import COUNT_PREFIX, EVENT_PREFIX, NOISE_CEILING, WHOLE_CLIP, Row
from rlbench.clips.header import LIMITATIONS, Header
from rlbench.clips.in_memory import ClipWrapper
from rlbench.clips.stored import StoredClip
from rlbench.frames import Clip, Frame, Samples, StoredPool
from rlbench.ops.sanitize import sanitize_motion
from rlbench.run import FrameResult
from rlbench.wrappers import TileMemory

if TYPE_CHECKING:
    from metrics.comparison import Comparison
    from metrics.ground_truth import GroundTruth
    from metrics.metric import Metric

MAX_PIXELS = 2**21  # of all frames of a clip that is kept: about 0.3 GB
EVENTS = {"cut": "another shot begins", "light": "lights change"}
COUNTED = "share of the pixels of all frames, pilot samples included"
CEILING = "the clip's header: PSNR of the noise-free image against the reference"
REPAIRED = "invalid pixels and samples, replaced before the method read them"
NO_REFERENCE = "the frame, or one before it that the metric reads, has no reference"
BLACK = "the reference is black, where PSNR nears its cap of 100 dB and lifts the mean over frames"
SKIPPED = "share of pixels kept from the last image, in tiles that did not change"


def buffers_of_truth(metrics: Iterable[Metric]) -> frozenset[str]:
    """The buffers that the ground truth holds for these metrics."""
    return frozenset({"motion"}).intersection(name for each in metrics for name in each.needs)


def make_ground_truth(metric: Metric, frame: Frame) -> GroundTruth:
    """The ground truth of a frame, by any metric."""
    buffers, static = frame.gbuffer.buffers, frame.gbuffer.static
    has_motion = "motion" in buffers and not static
    motion = sanitize_motion(buffers["motion"]).clone() if has_motion else None
    reference = frame.reference
    return metric.ground_truth_type(reference.half_a, reference.half_b, motion, static)


@dataclass(frozen=True)
class ClipWithTruth(ClipWrapper):
    """A clip whose ground truth is made before a method receives the frame, and may write to it."""

    make: Callable[[Frame], GroundTruth]
    keeps_all: bool  # or else the present frame's alone
    _by_index: dict[int, GroundTruth] = field(repr=False)

    def __iter__(self) -> Iterator[Frame]:
        """The frames in order."""
        for frame in self.clip:
            if not self.keeps_all:
                self._by_index.clear()
            if frame.index not in self._by_index:
                self._by_index[frame.index] = self.make(frame)
            yield frame

    def ground_truth(self, frame: Frame) -> GroundTruth:
        """The ground truth of the frame that was read last, or of any if it `keeps_all`."""
        return self._by_index[frame.index]


class GroundTruthCache:
    """The ground truth of one clip at a time, for as long as cells of that clip are scored.

    That of a clip with more than MAX_PIXELS pixels is not kept. A copy, as another process receives
    it, is empty.
    """

    def __init__(self, metric: Metric) -> None:
        """`metric` may be any: all make the same."""
        self._metric, self._digest = metric, ""
        self._by_index: dict[int, GroundTruth] = {}

    def open(self, clip: Clip) -> ClipWithTruth:
        """A clip with what is known of its ground truth; that of another clip is forgotten."""
        if clip.digest != self._digest:
            self._digest, self._by_index = clip.digest, {}
        make = partial(make_ground_truth, self._metric)
        is_small = len(clip) * math.prod(clip.size) <= MAX_PIXELS
        return ClipWithTruth(clip, make, is_small, self._by_index if is_small else {})

    def __reduce__(self) -> tuple[type[GroundTruthCache], tuple[Metric]]:
        """A copy without what is kept."""
        return GroundTruthCache, (self._metric,)


def row_template(
    key: CellKey,
    header: Header,
    run_id: str,
    code_hash: str,
    weights_hash: str = "",
    dtype: str = "",
    config: str = "{}",
) -> Row:
    """A row of this cell, on the clip of this header, without a number."""
    return Row(
        run_id=run_id,
        method=key.method,
        clip=header.name,
        scene=header.scene,
        target_spp=key.target_spp,
        mean_spp=math.nan,
        frame=WHOLE_CLIP,
        metric="",
        value=math.nan,
        seed=key.seed,
        preset=header.preset,
        device=key.device,
        dtype=dtype,
        code_hash=code_hash,
        weights_hash=weights_hash,
        config=config,
        size=f"{header.width}x{header.height}",
    )


def results_of_images(
    clip: StoredClip, images: Iterable[tuple[Tensor, Tensor]]
) -> Iterator[FrameResult]:
    """Images [3 h w] and sample counts [h w] of a clip's frames, as if a method had made them.

    No sample is read from the clip.
    """
    no_samples = torch.zeros(1, 1, 3, *clip.size[1:])
    for index, (image, counts) in enumerate(images):
        frame = clip.frame_with_pool(index, StoredPool(no_samples, (0,)))
        samples = Samples(no_samples[:, :0], counts[None, None])
        yield FrameResult(frame, samples, image[None], repairs={})


def refusal_row(template: Row, reason: str) -> Row:
    """The only row of a cell without numbers."""
    return replace(template, metric="psnr", value=math.nan, note=reason)


def compare_frame(
    metric: Metric,
    result: FrameResult,
    truth: GroundTruth,
    previous: Comparison | None,  # the frame before
    max_samples: int | None = None,
) -> Comparison:
    """A frame as any `metric` receives it.

    `max_samples` is the most that one pixel can have, None if that is not known.
    """
    return metric.comparison_type(
        result.image,
        truth,
        counts=result.samples.counts,
        max_samples=max_samples,
        previous=previous,
    )


def score_frames(
    template: Row,
    metrics: Sequence[Metric],
    results: Iterable[FrameResult],
    header: Header,
    ground_truth: Callable[[Frame], GroundTruth],
    max_samples: int | None = None,
) -> Iterator[tuple[FrameResult, list[Row]]]:
    """The frames of a clip in order, each with its rows. Raises as `score_frame` does."""
    compared = None
    for result in results:
        truth = ground_truth(result.frame)
        compared = compare_frame(metrics[0], result, truth, compared, max_samples)
        yield result, list(score_frame(template, metrics, compared, result, header))


def score_frame(
    template: Row,
    metrics: Iterable[Metric],
    comparison: Comparison,
    result: FrameResult,
    header: Header,
) -> Iterator[Row]:
    """One row of each metric that has the frames before that it reads, of each event and ceiling.

    Raises PluginError for an image of another shape or dtype than the reference.
    """
    _check_image(template.method, result.image, comparison.half_a)
    mean_spp = float(result.samples.counts.double().mean())
    frame = replace(template, frame=result.frame.index, mean_spp=mean_spp)
    for generic in metrics:
        metric = generic.at(*comparison.image.shape[-2:])  # as defined at this size
        if comparison.frames_before < metric.previous_frames:
            continue
        note = _missing_input(metric, comparison, header)
        score = math.nan if note else float(metric.score(comparison)[0])
        if math.isnan(score) and not note:
            note = f"the value is nan: {metric.convention}"
        if metric.name == "psnr" and not note and _is_black(comparison):
            note = BLACK
        yield _score_row(frame, metric, score, note)
    yield from _fact_rows(frame, header, result)


def _is_black(comparison: Comparison) -> bool:
    """Whether the reference is black on a display of 8 bits."""
    return bool(comparison.display_reference.amax() < 0.5 / 255)


def add_counts(pixels: Tensor, counts: Tensor) -> Tensor:
    """A histogram, `pixels[n]` of which have n samples, with the `counts` of one more frame added.

    `counts` are [n 1 h w]. The result has more bins than `pixels` where a pixel has more samples.
    """
    added = torch.bincount(counts.flatten().long(), minlength=len(pixels)).cpu()
    added[: len(pixels)] += pixels
    return added


def count_rows(template: Row, pixels: Tensor) -> list[Row]:
    """The histogram of a clip's sample counts: the share of pixels with 0, 1, ... samples.

    `pixels` is that of all frames, as `add_counts` returns it.
    """
    counted = list(enumerate(pixels.tolist()))
    total = sum(count for _, count in counted)
    mean_spp = sum(spp * count for spp, count in counted) / total
    row = replace(template, mean_spp=mean_spp, frame=WHOLE_CLIP, unit="%")
    return [
        with_value(row, f"{COUNT_PREFIX}{spp}", 100 * count / total, COUNTED)
        for spp, count in counted
    ]


def memory_rows(template: Row, metrics: Iterable[Metric], rows: Sequence[Row]) -> Iterator[Row]:
    """Scores such as `drift` of a method with a memory, from the PSNR rows of its frames."""
    scores = [row for row in rows if row.metric == "psnr"]
    notes = [row.note for row in scores if math.isnan(row.value)]
    mean_spp = sum(row.mean_spp for row in scores) / max(len(scores), 1)
    of_clip = replace(template, frame=WHOLE_CLIP, mean_spp=mean_spp)
    for metric in metrics:
        if metric.from_psnr and scores:
            value = metric.from_psnr([row.value for row in scores])
            note = next(iter(notes), "") if math.isnan(value) else ""
            yield _score_row(of_clip, metric, value, note)


def score_clip(
    template: Row, generic: Metric, comparisons: Sequence[Comparison], header: Header
) -> Row:
    """The row of a metric of the whole clip, whose frames are in order."""
    metric = generic.at(*comparisons[0].image.shape[-2:])
    notes = (_missing_input(metric, comparison, header) for comparison in comparisons)
    note = next(filter(None, notes), "")
    score = math.nan if note else float(metric.score(list(comparisons)))
    return _score_row(replace(template, frame=WHOLE_CLIP), metric, score, note)


def _missing_input(metric: Metric, comparison: Comparison, header: Header) -> str:
    """Why a metric has no score of a frame; empty if it has one."""
    if metric.needs_reference and not comparison.has_references(metric.previous_frames):
        return NO_REFERENCE
    if metric.needs_reference_halves and "halves" in header.limitations:
        return LIMITATIONS["halves"]
    lacks = [name for name in metric.needs if not comparison.has(name)]
    return f"the clip has no {' and no '.join(lacks)}, which the metric reads" if lacks else ""


def _fact_rows(frame: Row, header: Header, result: FrameResult) -> Iterator[Row]:
    """What the clip's header says of a frame, and what was repaired or skipped in it."""
    events = {"cut": header.cuts, "light": header.light_changes}
    for event, frames in events.items():
        if frame.frame in frames:
            convention = f"the clip's header: {EVENTS[event]}"
            yield with_value(frame, f"{EVENT_PREFIX}{event}", 1.0, convention)
    if ceilings := header.noise_ceiling_db:
        row = replace(frame, unit="dB")
        yield with_value(row, NOISE_CEILING, ceilings[frame.frame], CEILING)
    if repairs := result.repairs:
        kinds = ", ".join(f"{name} {count}" for name, count in sorted(repairs.items()))
        yield with_value(frame, "repaired", float(sum(repairs.values())), f"{REPAIRED}: {kinds}")
    if isinstance(result.state, TileMemory):
        yield with_value(frame, "tiles_skipped", result.state.skipped, SKIPPED)


def _score_row(row: Row, metric: Metric, score: float, note: str) -> Row:
    row = replace(row, unit=metric.unit, direction=metric.direction)
    return with_value(row, metric.name, score, metric.convention, note)


def with_value(row: Row, metric: str, value: float, convention: str, note: str = "") -> Row:
    """The row with a number; a value that is not finite becomes nan with a note."""
    if not math.isfinite(value):
        value, note = math.nan, note or f"the value is {value}"
    return replace(row, metric=metric, value=value, convention=convention, note=note)


def _check_image(method: str, image: Any, reference: Tensor) -> None:
    """Raise PluginError for an image that metrics would silently broadcast or round."""
    if not isinstance(image, torch.Tensor):
        kind = f"{type(image).__module__}.{type(image).__name__}"
        raise registry.PluginError(
            f"'{method}' returned an image of type {kind}, expected a torch.Tensor"
        )
    if image.shape != reference.shape or image.dtype != reference.dtype:
        raise registry.PluginError(
            f"'{method}' returned an image of {image.dtype} {list(image.shape)}, "
            f"expected {reference.dtype} {list(reference.shape)}"
        )
