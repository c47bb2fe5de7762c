"""Crops of a clip that a rule chooses: where two images differ most, and where they differ usually.

The difference of a crop is that of the mean squared errors of the two images in it. The first crop
has the largest difference of all frames. The second is of the same frame and does not touch the
first: of all such crops of the frame it has the median difference. Nobody chooses by eye.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from reports.analysis.image_errors import Floats

__all__ = ["SHARE", "Crop", "choose_crops"]

SHARE = 0.2  # side of a crop, as a share of the shorter side of the frame
STEPS = 4  # positions of crops within the side of one


class Crop(NamedTuple):
    """A square of a frame, in pixels."""

    frame: int
    top: int
    left: int
    side: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the crop."""
        rows = slice(self.top, self.top + self.side)
        return rows, slice(self.left, self.left + self.side)


def choose_crops(error: Floats, other: Floats) -> tuple[Crop, Crop]:
    """The crops with the largest and a median difference of two squared errors [t h w].

    >>> error = np.zeros((2, 50, 50)); error[1, 20:30, 30:40] = 1.0
    >>> choose_crops(error, np.zeros_like(error))[0]
    Crop(frame=1, top=20, left=30, side=10)
    """
    _, height, width = error.shape
    side = max(round(SHARE * min(height, width)), 1)
    step = max(side // STEPS, 1)
    difference = np.abs(_window_means(error - other, side, step))  # t rows columns
    frame, row, column = np.unravel_index(int(difference.argmax()), difference.shape)
    largest = Crop(int(frame), int(row) * step, int(column) * step, side)
    rows, columns = np.indices(difference.shape[1:]) * step
    is_apart = (abs(rows - largest.top) >= side) | (abs(columns - largest.left) >= side)
    order = np.argsort(difference[frame], axis=None, kind="stable")
    order = order[is_apart.ravel()[order]]
    middle = order[len(order) // 2]
    return largest, Crop(int(frame), int(rows.flat[middle]), int(columns.flat[middle]), side)


def _window_means(values: Floats, side: int, step: int) -> Floats:
    """Mean of each square of `side` pixels, every `step` pixels: [t rows columns]."""
    rows = sliding_window_view(values, side, axis=1)[:, ::step].mean(axis=-1)
    means: Floats = sliding_window_view(rows, side, axis=2)[:, :, ::step].mean(axis=-1)
    return means
