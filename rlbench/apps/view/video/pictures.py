"""The pictures of a video: labelled panels side by side, or two behind a moving divider."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from rlbench.apps.view.video.style import VideoStyle
from rlbench.benchmark.frame_images import LinearImage

if TYPE_CHECKING:
    from rlbench.benchmark.shown_clips import ShownClip

BACKGROUND = (24, 24, 24)
COUNT_COLOURS = "viridis"  # as in the page of rlbench view
SLICE_SHARE = 0.25  # height of a slice through time, as a share of the image above it
SLICE_GAP = 4  # pixels between them
MARK = 255  # white: the line of the slice, and the frame in the slice
LABEL_COLOUR = (235, 235, 235)
LARGEST, SMALLEST = 16, 8  # height of the font, pixels
LINE_HEIGHT = 1.6  # of the font's
MARGIN = 0.4  # at both ends, and twice as much between the texts; of the font's height
ELLIPSIS = "…"
GAP = 4  # pixels between panels
DIVIDER = 2  # pixels
Rgb8 = NDArray[np.uint8]  # [h w 3]


class Panel(NamedTuple):
    """One picture after the other, in pixels of the clip, and what is written above them."""

    title: str
    remarks: Sequence[str]  # of each frame
    frames: Rgb8  # [t h w 3]
    line: int | None  # of `frames`, whose slice through time is shown


def panels_of(clip: ShownClip, style: VideoStyle) -> list[Panel]:
    """The panels in their order: each row, the samples of an adaptive row, the reference.

    `clip` is that of `at_budget`; its reference may be empty, and is not shown then.
    """
    height, width = clip.images[0].frames.shape[2:]
    x, y, w, h = style.crop or (0, 0, width, height)
    line = None if style.line is None else style.line - y
    return [
        Panel(title, remarks, frames[:, y : y + h, x : x + w], line)
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


def _contents(clip: ShownClip, style: VideoStyle) -> Iterator[tuple[str, Sequence[str], Rgb8]]:
    """Title, remarks and frames of each panel."""
    most = max(float(row.counts.max()) for row in clip.images)
    titles = style.titles or [row.method for row in clip.images]
    for row, title in zip(clip.images, titles, strict=True):
        scores = ["" if math.isnan(psnr) else f"  {psnr:.1f} dB" for psnr in row.psnr]
        yield title, [f"{row.target_spp:g} spp{score}" for score in scores], _to_display(row.frames)
        least, largest = row.counts.min(), row.counts.max()
        if style.samples and least < largest - 1:  # counts that differ by more than rounding
            extent = f"{least:g} to {largest:g} a pixel"
            share = (row.counts / most).astype(np.float32)
            colours = mpl.colormaps[COUNT_COLOURS](share, bytes=True)[..., :3]
            yield f"samples of {title}", [extent] * len(colours), colours
    if len(clip.reference):
        yield "reference", [""] * len(clip.reference), _to_display(clip.reference)


def _to_display(frames: Float[Array, "t 3 h w"]) -> Rgb8:
    """Clipped sRGB in 8 bits [t h w 3]; pixels that are not finite are magenta."""
    linear = np.moveaxis(frames.astype(np.float32), 1, -1)
    return np.stack([LinearImage(frame).rgb8 for frame in linear])


def _magnify(picture: Rgb8, rows: int, columns: int) -> Rgb8:
    """Each pixel as a block of `rows` x `columns` pixels."""
    return picture.repeat(rows, axis=0).repeat(columns, axis=1)


def _mark_edges(picture: Rgb8, top: int, height: int) -> None:
    """Mark some lines of a picture by a bar at both edges."""
    length = max(2, picture.shape[1] // 32)
    picture[top : top + height, :length] = MARK
    picture[top : top + height, -length:] = MARK


class Label(NamedTuple):
    """A line with a text at its left end and one at its right end."""

    left: str
    right: str


@cache
def fit_size(labels: tuple[Label, ...], width: int) -> int:
    """The largest size of the font at which all labels fit `width` pixels, or the smallest."""
    different = set(labels)
    for size in range(LARGEST, SMALLEST, -1):
        if all(_text_width(label, size) <= width for label in different):
            return size
    return SMALLEST


@cache
def draw_label(label: Label, width: int, size: int) -> Rgb8:
    """The label in a line of even height; a left text that is too long ends with an ellipsis."""
    height = 2 * round(LINE_HEIGHT * size / 2)
    image = Image.new("RGB", (width, height), BACKGROUND)
    draw, font, margin = ImageDraw.Draw(image), _font(size), round(MARGIN * size)
    left = label.left
    while left and _text_width(Label(left, label.right), size) > width:
        left = left.removesuffix(ELLIPSIS)[:-1] + ELLIPSIS if left != ELLIPSIS else ""
    draw.text((margin, height // 2), left, LABEL_COLOUR, font, "lm")
    draw.text((width - margin, height // 2), label.right, LABEL_COLOUR, font, "rm")
    return np.asarray(image)


def _text_width(label: Label, size: int) -> float:
    texts = [text for text in label if text]
    return sum(map(_font(size).getlength, texts)) + 2 * len(texts) * MARGIN * size


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which matplotlib brings and the figures use; its digits have one width."""
    file = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return ImageFont.truetype(str(file), size, layout_engine=ImageFont.Layout.BASIC)


def pictures(panels: Sequence[Panel], style: VideoStyle) -> Iterator[Rgb8]:
    """One loop of the video; all pictures have the same size, even in both directions."""
    frames = len(panels[0].frames)
    count = style.pictures(frames)
    order = style.frame_order(frames) * style.passes(frames)
    for index in range(count):
        frame = order[index // style.steps]
        if style.layout == "wipe":
            picture = _wipe(panels, style, frame, divider_position(index, count))
        else:
            picture = _side_by_side(panels, style, frame)
        height, width, _ = picture.shape
        yield _extend(picture, height + height % 2, width + width % 2)


def divider_position(index: int, count: int) -> float:
    """Where the divider is in picture `index` of a loop, as a share of the width.

    It starts in the middle, goes to the right, then to the left, and rests longest at the ends.

    >>> [round(divider_position(index, 4), 3) for index in range(4)]
    [0.5, 1.0, 0.5, 0.0]
    """
    return 0.5 + 0.5 * math.sin(2 * math.pi * index / count)


def _wipe(panels: Sequence[Panel], style: VideoStyle, frame: int, position: float) -> Rgb8:
    """The first panel left of the divider, and the second right of it."""
    left, right = (draw_panel(panel, frame, style.zoom) for panel in panels)
    height, width, _ = left.shape
    x = round(position * width)
    picture = np.concatenate([left[:, :x], right[:, x:]], axis=1)
    start = min(max(x - DIVIDER // 2, 0), width - DIVIDER)
    picture[:, start : start + DIVIDER] = 255
    if style.labels:
        texts = [[f"{panel.title}  {remark}" for remark in panel.remarks] for panel in panels]
        (picture,) = _add_labels([picture], [list(map(Label, *texts))], frame)
    return picture


def _side_by_side(panels: Sequence[Panel], style: VideoStyle, frame: int) -> Rgb8:
    """Panels in lines of `style.columns`, each with its label above it."""
    drawn = [draw_panel(panel, frame, style.zoom) for panel in panels]
    if style.labels:
        labels = [[Label(panel.title, remark) for remark in panel.remarks] for panel in panels]
        drawn = _add_labels(drawn, labels, frame)
    height, width, _ = drawn[0].shape
    columns = min(style.columns or len(drawn), len(drawn))
    lines = -(-len(drawn) // columns)
    canvas = _extend(drawn[0][:0, :0], lines * (height + GAP) - GAP, columns * (width + GAP) - GAP)
    for index, picture in enumerate(drawn):
        top, left = index // columns * (height + GAP), index % columns * (width + GAP)
        canvas[top : top + height, left : left + width] = picture
    return canvas


def _add_labels(drawn: Sequence[Rgb8], labels: Sequence[Sequence[Label]], frame: int) -> list[Rgb8]:
    """Pictures of one width below their labels of a frame; the font fits the labels of all."""
    width = drawn[0].shape[1]
    size = fit_size(tuple(chain.from_iterable(labels)), width)
    return [
        np.concatenate([draw_label(of_frame[frame], width, size), picture])
        for of_frame, picture in zip(labels, drawn, strict=True)
    ]


def _extend(picture: Rgb8, height: int, width: int) -> Rgb8:
    """The picture with background below and to the right of it."""
    extended = np.full((height, width, 3), BACKGROUND, np.uint8)
    extended[: picture.shape[0], : picture.shape[1]] = picture
    return extended
