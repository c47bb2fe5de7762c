"""Rows of the results table from images; `time_rows` adds those of times."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from rlbench import registry
from rlbench.benchmark.resolve import ResolvedCell
from rlbench.benchmark.results import WHOLE_CLIP, Row
from rlbench.clips.header import LIMITATIONS, Header
from rlbench.run import FrameResult
from rlbench.sanitize import Repairs
from rlbench.wrappers import TileMemory

__all__ = ["refusal_row", "row_template", "score_frame"]

SKIPPED = "share of pixels kept from the last image, in tiles that did not change"


def row_template(cell: ResolvedCell, run_id: str, code_hash: str, weights_hash: str) -> Row:
    """A row of this cell, without a number."""
    return Row(
        run_id=run_id,
        method=cell.method.row_name,
        clip=cell.header.name,
        scene=cell.header.scene,
        target_spp=cell.target_spp,
        mean_spp=math.nan,
        frame=WHOLE_CLIP,
        metric="",
        value=math.nan,
        seed=cell.seed,
        preset=cell.header.preset,
        device=cell.key.device,
        dtype="bfloat16" if cell.method.bf16 else "float32",
        code_hash=code_hash,
        weights_hash=weights_hash,
        size=f"{cell.header.width}x{cell.header.height}",
    )


def refusal_row(template: Row, reason: str) -> Row:
    """The only row of a cell without numbers."""
    return replace(template, metric="psnr", value=math.nan, note=reason)


def score_frame(
    template: Row,
    metrics: Iterable[Any],  # as metrics.catalog.Metric
    result: FrameResult,
    previous: FrameResult | None,
    header: Header,
) -> Iterator[Row]:
    """One row of each metric; temporal metrics need the `previous` frame.

    Raises PluginError for an image of another shape or dtype than the reference.
    """
    images = _images(result)
    _check_image(template.method, images[0], images[1])
    mean_spp = float(result.samples.counts.double().mean())
    frame = replace(template, frame=result.frame.index, mean_spp=mean_spp)
    for generic in metrics:
        metric = generic.at(*result.image.shape[-2:])  # as defined at this size
        if metric.temporal and previous is None:
            continue
        scored = _paired(_images(previous), images) if metric.temporal and previous else images
        undefined = metric.needs_reference_halves and "halves" in header.limitations
        score = math.nan if undefined else float(metric.score(*scored)[0])
        note = LIMITATIONS["halves"] if undefined else ""
        if math.isnan(score) and not undefined:
            note = f"the value is nan: {metric.convention}"
        row = replace(frame, unit=metric.unit, direction=metric.direction)
        yield _with_value(row, metric.name, score, metric.convention, note)
    yield from _repair_rows(frame, result.repairs)
    if isinstance(result.state, TileMemory):
        yield _with_value(frame, "tiles_skipped", result.state.skipped, SKIPPED)


def _repair_rows(frame: Row, repairs: Repairs) -> Iterator[Row]:
    """A row with the number of invalid pixels and samples that were replaced, if there were any."""
    if repairs:
        kinds = ", ".join(f"{name} {count}" for name, count in sorted(repairs.items()))
        convention = f"invalid pixels and samples, replaced before the method read them: {kinds}"
        yield _with_value(frame, "repaired", float(sum(repairs.values())), convention)


def _with_value(row: Row, metric: str, value: float, convention: str, note: str = "") -> Row:
    """The row with a number; a value that is not finite becomes nan with a note."""
    if not math.isfinite(value):
        note, value = note or f"the value is {value}", math.nan
    return replace(row, metric=metric, value=value, convention=convention, note=note)


def _images(result: FrameResult) -> list[Tensor]:
    """The image and both halves of its reference."""
    reference = result.frame.reference
    return [result.image, reference.half_a, reference.half_b]


def _paired(previous: Sequence[Tensor], images: Sequence[Tensor]) -> list[Tensor]:
    """Each image with that of the previous frame: [n 2 3 h w]."""
    return [torch.stack(pair, 1) for pair in zip(previous, images, strict=True)]


def _check_image(method: str, image: Tensor, reference: Tensor) -> None:
    """Raise PluginError for an image that metrics would silently broadcast or round."""
    if image.shape != reference.shape or image.dtype != reference.dtype:
        raise registry.PluginError(
            f"'{method}' returned an image of {image.dtype} {list(image.shape)}, "
            f"expected {reference.dtype} {list(reference.shape)}"
        )
