"""The pictures of a video: panels side by side, or two behind a moving divider."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from reports.video.labels import Label, draw_label, fit_size
from reports.video.panels import BACKGROUND, Panel, Rgb8, draw_panel
from reports.video.style import VideoStyle

__all__ = ["divider_position", "pictures"]

GAP = 4  # pixels between panels
DIVIDER = 2  # pixels


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
