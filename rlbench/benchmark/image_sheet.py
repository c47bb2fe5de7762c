"""A sheet of one frame: image, errors and sample counts of each method, beside the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from rlbench.ops.color import encode_srgb
from rlbench.system import paths

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

__all__ = ["NONFINITE_COLOUR", "LinearImage", "MethodImage", "draw_sheet"]

NONFINITE_COLOUR = (255, 0, 255)  # of NaN and infinite pixels, which a display would hide
MAX_ERROR = 0.25  # end of the error scale: mean over channels, in units of display white
DIFFERENCE_PERCENTILE = 98  # of the sizes of differences, at the ends of their scale
PANEL_INCHES, TITLE_INCHES = 2.6, 0.25  # width of a panel, and height of the line above it
DPI = 150


@dataclass(frozen=True)
class LinearImage:
    """An image in linear radiance, with its display values computed once."""

    radiance: Float[Array, "h w 3"]  # linear, 1.0 is display white

    @cached_property
    def srgb(self) -> Float[Array, "h w 3"]:
        """Clipped sRGB in [0, 1], as PSNR sees it; NaN is black."""
        finite = np.nan_to_num(self.radiance, nan=0.0).clip(0, 1)
        return encode_srgb(torch.from_numpy(finite)).clamp(0, 1).numpy()

    @cached_property
    def rgb8(self) -> UInt8[Array, "h w 3"]:
        """Clipped sRGB in 8 bits; pixels that are not finite have NONFINITE_COLOUR."""
        rgb8 = np.rint(self.srgb * np.float32(255)).astype(np.uint8)
        rgb8[~np.isfinite(self.radiance).all(-1)] = NONFINITE_COLOUR
        return rgb8

    @property
    def nonfinite_pixels(self) -> int:
        """Number of pixels with a NaN or infinite channel."""
        return int((~np.isfinite(self.radiance).all(-1)).sum())


@dataclass(frozen=True)
class MethodImage:
    """One frame of a method: the image, its score, and the samples it took."""

    row_name: str  # of the method, as in the results
    image: LinearImage
    counts: Int[Array, "h w"]  # samples of each pixel
    psnr: float  # dB


def draw_sheet(
    methods: Sequence[MethodImage], reference: LinearImage, title: str, file: Path
) -> Path:
    """Write a PNG with a column for each method, reference first; returns `file`.

    Its rows are images, errors, for several methods their squared error minus that of the best one,
    and, if any method is adaptive, samples of each pixel.
    """
    from matplotlib.figure import Figure

    is_adaptive, is_compared = any(map(_is_adaptive, methods)), len(methods) > 1
    rows, columns = 2 + is_compared + is_adaptive, 1 + len(methods)
    h, w, _ = reference.radiance.shape
    width, height = PANEL_INCHES * columns, (PANEL_INCHES * h / w + TITLE_INCHES) * rows
    figure = Figure(figsize=(width, height + TITLE_INCHES))
    grid = figure.subplots(rows, columns, squeeze=False)
    top = 1 - 2 * TITLE_INCHES / (height + TITLE_INCHES)
    spacing = {"wspace": 0.02, "hspace": TITLE_INCHES * rows / height}
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=top, **spacing)
    for axes in grid.flat:
        axes.set_axis_off()
    _draw_images(grid[0], methods, reference)
    _draw_errors(grid[1], methods, reference)
    if is_compared:
        _draw_differences(grid[2], methods, reference)
    if is_adaptive:
        _draw_counts(grid[-1], methods)
    figure.suptitle(title, fontsize=9, y=1 - 0.25 * TITLE_INCHES / (height + TITLE_INCHES))
    with paths.atomic_write(file) as temporary:
        figure.savefig(temporary, dpi=DPI, format="png")
    return file


def _draw_images(
    row: Sequence[Axes], methods: Sequence[MethodImage], reference: LinearImage
) -> None:
    _panel(row[0], reference.rgb8, "reference")
    for axes, method in zip(row[1:], methods, strict=True):
        nonfinite = method.image.nonfinite_pixels
        warning = f", {nonfinite} not finite" if nonfinite else ""
        _panel(axes, method.image.rgb8, f"{method.row_name}  {method.psnr:.2f} dB{warning}")


def _draw_errors(
    row: Sequence[Axes], methods: Sequence[MethodImage], reference: LinearImage
) -> None:
    for axes, method in zip(row[1:], methods, strict=True):
        error = np.abs(method.image.srgb - reference.srgb).mean(-1)
        drawn = _panel(axes, error, "error", cmap="magma", vmin=0, vmax=MAX_ERROR)
    _color_bar(row[0], drawn, "absolute error in sRGB,\nmean over channels", "max")


def _draw_differences(
    row: Sequence[Axes], methods: Sequence[MethodImage], reference: LinearImage
) -> None:
    """Squared errors minus that of the method with the highest PSNR; red is worse than it."""
    errors = [((method.image.srgb - reference.srgb) ** 2).mean(-1) for method in methods]
    best = max(range(len(methods)), key=lambda i: methods[i].psnr)
    others = [error - errors[best] for i, error in enumerate(errors) if i != best]
    limit = float(np.percentile(np.abs(others), DIFFERENCE_PERCENTILE)) or 1.0
    for i, axes in enumerate(row[1:]):
        if i == best:
            _write(axes, "the best: others minus this")
            continue
        title = f"squared error minus that of {methods[best].row_name}"
        difference = errors[i] - errors[best]
        drawn = _panel(axes, difference, title, cmap="RdBu_r", vmin=-limit, vmax=limit)
    _color_bar(row[0], drawn, "difference of squared error in sRGB,\nmean over channels", "both")


def _is_adaptive(method: MethodImage) -> bool:
    """Do the samples of two pixels differ by more than a rounded budget makes them?"""
    return bool(method.counts.min() < method.counts.max() - 1)


def _draw_counts(row: Sequence[Axes], methods: Sequence[MethodImage]) -> None:
    most = max(int(method.counts.max()) for method in methods)
    for axes, method in zip(row[1:], methods, strict=True):
        if not _is_adaptive(method):
            _write(axes, f"uniform: {method.counts.mean():.3g} spp")
            continue
        title = f"{method.counts.min()} to {method.counts.max()} samples per pixel"
        drawn = _panel(axes, method.counts, title, cmap="viridis", vmin=0, vmax=most)
    _color_bar(row[0], drawn, "samples per pixel", "neither")


def _write(axes: Axes, text: str) -> None:
    """A sentence in place of a panel that would show one colour."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=9)


def _panel(axes: Axes, values: Array, title: str, **style: Any) -> AxesImage:
    axes.set_title(title, fontsize=8, pad=3)
    return axes.imshow(values, interpolation="nearest", **style)


def _color_bar(axes: Axes, drawn: AxesImage, label: str, extend: str) -> None:
    """The scale of a row, in the column of the reference."""
    inset = axes.inset_axes((0.1, 0.5, 0.8, 0.05))
    bar = axes.figure.colorbar(drawn, cax=inset, orientation="horizontal", extend=extend)
    bar.set_label(label, fontsize=8)
    inset.tick_params(labelsize=7)
