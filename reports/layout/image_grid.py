"""Panels of images, without axes, and a caption below them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from reports.analysis.images import Floats, encode_srgb
from reports.layout import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

NONFINITE_COLOUR = (1.0, 0.0, 1.0)  # of NaN and infinite pixels
CAPTION_LETTERS = 165  # in a line of 13 inches


def draw_picture(axes: Axes, radiance: Floats, title: str = "") -> AxesImage:
    """Show a linear image [3 h w] in sRGB; pixels that are not finite are magenta."""
    display = encode_srgb(radiance).transpose(1, 2, 0)
    finite = np.asarray(np.isfinite(radiance.astype(np.float32)).all(axis=0))
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_title(title, fontsize=10.5, pad=4)
    shown = np.where(finite[..., None], display, NONFINITE_COLOUR)
    return axes.imshow(shown, interpolation="nearest")


def add_caption(figure: Figure, caption: str) -> None:
    """Write a caption at the lower edge."""
    letters = int(CAPTION_LETTERS * figure.get_figwidth() / 13.0)
    text = style.wrap_lines(caption, letters)
    figure.text(0.012, 0.08 / figure.get_figheight(), text, fontsize=10.5, color=style.BLACK,
                va="bottom")  # fmt: skip
