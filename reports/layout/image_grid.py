"""Panels of images: pictures, maps with one scale, frames of crops, and a colour bar."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from reports.analysis.images import Floats, encode_srgb
from reports.layout import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

NONFINITE_COLOUR = (1.0, 0.0, 1.0)  # of NaN and infinite pixels
FOOTER = 1.35  # inches, of colour bar and caption
CAPTION_LETTERS = 165  # in a line of 13 inches
PERCENTILE = 99.0  # of the sizes in maps, at the end of their scale


def draw_picture(axes: Axes, radiance: Floats, title: str = "") -> AxesImage:
    """Show a linear image [3 h w] in sRGB; pixels that are not finite are magenta."""
    display = encode_srgb(radiance).transpose(1, 2, 0)
    finite = np.asarray(np.isfinite(radiance.astype(np.float32)).all(axis=0))
    return draw_map(axes, np.where(finite[..., None], display, NONFINITE_COLOUR), title)


def draw_map(axes: Axes, values: Floats, title: str = "", **scale: Any) -> AxesImage:
    """Show a map [h w] with a colour map and limits: `cmap`, `vmin`, `vmax`."""
    hide_axes(axes)
    axes.set_title(title, fontsize=10.5, pad=4)
    return axes.imshow(values, interpolation="nearest", **scale)


def hide_axes(axes: Axes) -> None:
    """Hide ticks, grid and spines."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def end_of_scale(maps: Iterable[Floats]) -> float:
    """The end of a scale from zero, or about zero: PERCENTILE of all sizes; 1 if all are 0."""
    sizes = np.concatenate([np.abs(values).ravel() for values in maps])
    return float(np.percentile(sizes, PERCENTILE)) or float(sizes.max()) or 1.0


def add_colour_bar(
    figure: Figure, drawn: AxesImage, label: str, span: tuple[float, float], extend: str
) -> None:
    """A horizontal colour bar below the panels; `span`: left and width as shares of the figure."""
    height = figure.get_figheight()
    box = (span[0], (FOOTER - 0.3) / height, span[1], 0.14 / height)
    bar = figure.colorbar(drawn, cax=figure.add_axes(box), orientation="horizontal", extend=extend)
    bar.set_label(label, fontsize=11)
    bar.ax.tick_params(labelsize=10.5)
    bar.locator = MaxNLocator(6)
    bar.update_ticks()
    bar.ax.grid(visible=False)


def add_caption(figure: Figure, caption: str) -> None:
    """Write a caption at the lower edge."""
    letters = int(CAPTION_LETTERS * figure.get_figwidth() / 13.0)
    text = style.wrap_lines(caption, letters)
    figure.text(0.012, 0.08 / figure.get_figheight(), text, fontsize=10.5, color=style.BLACK,
                va="bottom")  # fmt: skip
