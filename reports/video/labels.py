"""Lines of text above pictures."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from reports.video.panels import BACKGROUND, Rgb8

__all__ = ["Label", "draw_label", "fit_size"]

COLOUR = (235, 235, 235)
LARGEST, SMALLEST = 16, 8  # height of the font, pixels
LINE_HEIGHT = 1.6  # of the font's
MARGIN = 0.4  # at both ends, and twice as much between the texts; of the font's height
ELLIPSIS = "…"


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
    draw.text((margin, height // 2), left, COLOUR, font, "lm")
    draw.text((width - margin, height // 2), label.right, COLOUR, font, "rm")
    return np.asarray(image)


def _text_width(label: Label, size: int) -> float:
    texts = [text for text in label if text]
    return sum(map(_font(size).getlength, texts)) + 2 * len(texts) * MARGIN * size


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which matplotlib brings and the figures use; its digits have one width."""
    file = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return ImageFont.truetype(str(file), size, layout_engine=ImageFont.Layout.BASIC)
