"""Crops of the worst change: the part of a frame where most was lost, as small PNG files.

Images come from those that `rlbench run --keep-images` stored. Without them the frame is computed
again, which needs the clip, the method and its weights. Images of before exist only if stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from rlbench.benchmark.regression.comparison import BaselineDiff
from rlbench.benchmark.results import RowName

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.clip_sources import StoredSource
    from rlbench.benchmark.frame_images import LinearImage

SIDE, STEP = 64, 8  # pixels of a crop, and between two that are compared
SCALE = 4  # pixels of the file for one of the image
MAX_DIFFERENCE = 0.25  # of sRGB values, mean over channels, at the end of the scale


class FrameKey(NamedTuple):
    """One frame of one cell of the results."""

    method: str  # name of the rows
    clip: str
    target_spp: float
    seed: int
    frame: int
    psnr: float  # dB


@dataclass(frozen=True)
class Crops:
    """The files of the worst change."""

    title: str
    files: dict[str, Path]  # reference, before (where there is one), now, difference

    @property
    def folder(self) -> Path:
        """The folder of all files."""
        return self.files["now"].parent


def write_crops(
    diff: BaselineDiff,
    table: pd.DataFrame,
    seed: int,
    clips: Sequence[StoredSource],
    results: Path,
    folder: Path,
    before: Path | None = None,
) -> Crops:
    """Write crops of one frame of a cell: reference, before, now, and the difference.

    The frame is the one with the lowest PSNR of the cell; the crop is the square with the largest
    squared error in sRGB, or with its largest rise where `before`, a results folder, has an image
    of the frame. The difference is that to the image of before, or else to the reference. Raises
    ImagesError, and what the method raises, where there is no image.
    """
    from rlbench.benchmark.frame_images import ImagesError, LinearImage, save_png
    from rlbench.clips.stored import open_clip

    key = _worst_frame(diff, table, seed)
    source = next((clip for clip in clips if clip.header.name == key.clip), None)
    if source is None:
        raise ImagesError(f"clip {key.clip} is not here. Name its folder by --clips")
    stored = open_clip(source.folder, frozenset(), 1).frame(key.frame).reference.mean
    reference = LinearImage(stored[0].movedim(0, -1).numpy())
    kept = _kept_image(results, key)
    now = _compute(key, source) if kept is None else kept
    then = _kept_image(before, key) if before else None
    error = _squared_error(now, reference)
    tile = select_tile(error if then is None else error - _squared_error(then, reference))
    images = {"reference": reference} | ({} if then is None else {"before": then}) | {"now": now}
    pixels = {name: image.rgb8[tile] for name, image in images.items()}
    pixels["difference"] = _difference(now, reference if then is None else then)[tile]
    files = {name: folder / f"{name}.png" for name in pixels}
    for name, values in pixels.items():
        save_png(values.repeat(SCALE, 0).repeat(SCALE, 1), files[name])
    rows, columns = tile
    where = f"pixels ({columns.start}, {rows.start}) to ({columns.stop}, {rows.stop})"
    origin = "computed again" if kept is None else "as stored"
    title = f"{diff.key}, clip {key.clip}, frame {key.frame} ({key.psnr:.2f} dB), {where}, {origin}"
    return Crops(title, files)


def _kept_image(results: Path, key: FrameKey) -> LinearImage | None:
    """The stored image of a frame in a results folder, or None if it has none."""
    from rlbench.benchmark.cell_images import list_images
    from rlbench.benchmark.frame_images import LinearImage

    for kept in list_images(results):
        cell = kept.cell.key
        if (cell.method, cell.clip, cell.target_spp, cell.seed) == key[:4]:
            image = kept.frame(key.frame).image
            return LinearImage(np.moveaxis(image, 0, -1).astype(np.float32))
    return None


def select_tile(values: Float[Array, "h w"]) -> tuple[slice, slice]:
    """Rows and columns of the square with the largest sum, of 64 pixels or the shorter side.

    >>> values = np.zeros((100, 200))
    >>> values[90, 150] = 1.0
    >>> select_tile(values)
    (slice(32, 96, None), slice(88, 152, None))
    """
    side = min(SIDE, *values.shape)
    tops, lefts = ([*range(0, n - side, STEP), n - side] for n in values.shape)
    windows = np.lib.stride_tricks.sliding_window_view(values, (side, side))
    sums = windows[np.ix_(tops, lefts)].sum((-2, -1))
    top, left = np.unravel_index(sums.argmax(), sums.shape)
    row, column = tops[top], lefts[left]
    return slice(row, row + side), slice(column, column + side)


def _worst_frame(diff: BaselineDiff, table: pd.DataFrame, seed: int) -> FrameKey:
    method, scene, target_spp = diff.key
    rows = table[
        (table["metric"] == "psnr")
        & (table["method"] == method)
        & (table["scene"] == scene)
        & (table["target_spp"] == target_spp)
        & (table["seed"] == seed)
    ]
    row = rows.sort_values("value").iloc[0]
    return FrameKey(method, row["clip"], target_spp, seed, int(row["frame"]), float(row["value"]))


def _compute(key: FrameKey, clip: StoredSource) -> LinearImage:
    """The image of a frame, by running the method up to it."""
    import torch

    from rlbench.benchmark.frame_images import ImagesError, frame_at, method_image
    from rlbench.benchmark.run_plan import CellLoader, RunPlan, list_cells
    from rlbench.run import run_clip

    row = RowName.parse(key.method)
    options = row.options
    if options.weights:
        raise ImagesError(
            f"{key.method} has weights that the results name and do not hold. Store its images: "
            "rlbench run --keep-images"
        )
    plan = RunPlan(
        (row.method_name,),
        (clip,),
        (key.target_spp,),
        (key.seed,),
        torch.device("cpu"),
        half=options.half,
        backend=options.backend,
        skip_tiles=options.skip_tiles,
    )
    loader, (cell,) = CellLoader(plan), list_cells(plan)
    results = run_clip(loader.method(cell), loader.clip(cell), key.target_spp)
    return method_image(key.method, frame_at(results, key.frame)).image


def _squared_error(image: LinearImage, reference: LinearImage) -> Float[Array, "h w"]:
    error: Array = np.square(image.srgb - reference.srgb).mean(-1)
    return error


def _difference(image: LinearImage, other: LinearImage) -> UInt8[Array, "h w 3"]:
    """Absolute difference in sRGB, mean over channels, in colours from black to yellow."""
    from matplotlib import colormaps

    share = np.abs(image.srgb - other.srgb).mean(-1) / MAX_DIFFERENCE
    colours: Array = colormaps["magma"](share.clip(0, 1), bytes=True)
    return colours[..., :3]
