"""The panels of a video: the images of each row, where its samples went, and the reference."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from reports.video.style import VideoStyle

__all__ = ["BACKGROUND", "DisplayClip", "DisplayImages", "Panel", "Rgb8", "draw_panel", "panels_of"]

BACKGROUND = (24, 24, 24)
COUNT_COLOURS = "viridis"  # as in the page of rlbench view
SLICE_SHARE = 0.25  # height of a slice through time, as a share of the image above it
SLICE_GAP = 4  # pixels between them
MARK = 255  # white: the line of the slice, and the frame in the slice

Rgb8 = NDArray[np.uint8]  # [h w 3]


class DisplayImages(Protocol):
    """What a display shows of one row, or of the reference."""

    name: str
    frames: Rgb8  # [t h w 3]
    counts: NDArray[np.floating[Any]]  # [t h w], samples of each pixel
    psnr: Sequence[float]  # dB of each frame; NaN where it is not known


class DisplayClip(Protocol):
    """A clip with the images of some rows at one budget."""

    name: str
    target_spp: float
    rows: Sequence[DisplayImages]
    reference: Rgb8 | None  # [t h w 3]


@dataclass(frozen=True)
class Panel:
    """One picture after the other, in pixels of the clip, and what is written above them."""

    title: str
    remarks: Sequence[str]  # of each frame
    frames: Rgb8  # [t h w 3]
    line: int | None  # of `frames`, whose slice through time is shown


def panels_of(clip: DisplayClip, style: VideoStyle) -> list[Panel]:
    """The panels in their order: each row, the samples of an adaptive row, the reference."""
    return [
        Panel(title, remarks, _crop(frames, style), _line(style))
        for title, remarks, frames in _contents(clip, style)
    ]


def draw_panel(panel: Panel, frame: int, zoom: int) -> Rgb8:
    """The picture of one frame, and below it the slice through time, if there is one."""
    picture = _magnify(panel.frames[frame], zoom, zoom)
    if panel.line is None:
        return picture
    _mark_edges(picture, panel.line * zoom, zoom)
    frames, height = panel.frames.shape[:2]
    step = max(zoom, round(SLICE_SHARE * height * zoom / frames))  # height of one frame
    through_time = _magnify(panel.frames[:, panel.line], step, zoom)
    _mark_edges(through_time, frame * step, step)
    gap = np.full((SLICE_GAP, picture.shape[1], 3), BACKGROUND, np.uint8)
    return np.concatenate([picture, gap, through_time])


def _contents(clip: DisplayClip, style: VideoStyle) -> Iterator[tuple[str, Sequence[str], Rgb8]]:
    """Title, remarks and frames of each panel."""
    spp = f"{clip.target_spp:g} spp"
    most = max(float(row.counts.max()) for row in clip.rows)
    for row, title in zip(clip.rows, style.titles or [row.name for row in clip.rows], strict=True):
        scores = ["" if math.isnan(psnr) else f"  {psnr:.1f} dB" for psnr in row.psnr]
        yield title, [spp + score for score in scores], row.frames
        if style.samples and _is_adaptive(row):
            extent = f"{row.counts.min():g} to {row.counts.max():g} a pixel"
            colours = _colour_counts(row.counts / most)
            yield f"samples of {title}", [extent] * len(colours), colours
    if clip.reference is not None:
        yield "reference", [""] * len(clip.reference), clip.reference


def _is_adaptive(row: DisplayImages) -> bool:
    """Do counts differ by more than rounding?"""
    return bool(row.counts.min() < row.counts.max() - 1)


def _colour_counts(share: NDArray[np.floating[Any]]) -> Rgb8:
    """Colours of samples [t h w], where 1 is the most of a pixel."""
    colours: Rgb8 = mpl.colormaps[COUNT_COLOURS](share.astype(np.float32), bytes=True)[..., :3]
    return colours


def _crop(frames: Rgb8, style: VideoStyle) -> Rgb8:
    if style.crop is None:
        return frames
    x, y, width, height = style.crop
    return frames[:, y : y + height, x : x + width]


def _line(style: VideoStyle) -> int | None:
    """The line of the slice in the part of the frame that is shown."""
    return None if style.line is None else style.line - (style.crop or (0, 0))[1]


def _magnify(picture: Rgb8, rows: int, columns: int) -> Rgb8:
    """Each pixel as a block of `rows` x `columns` pixels."""
    return picture.repeat(rows, axis=0).repeat(columns, axis=1)


def _mark_edges(picture: Rgb8, top: int, height: int) -> None:
    """Mark some lines of a picture by a bar at both edges."""
    length = max(2, picture.shape[1] // 32)
    picture[top : top + height, :length] = MARK
    picture[top : top + height, -length:] = MARK
