"""Where the error lives: the share of squared error by motion, visibility, geometry, luminance."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib as mpl
import pandas as pd

from reports.analysis.image_errors import squared_error
from reports.analysis.places import KINDS, classify
from reports.analysis.shown_rows import select_images
from reports.layout import style
from reports.layout.page import describe_clips
from reports.layout.share_bars import MAX_ROWS, draw_shares
from reports.viewer.pictures import ShownClip

__all__ = ["error_shares", "write"]

USUAL = ("ours", "accumulate/contrast", "ntas", "oidn/tuned")
GROUP = ["method", "target_spp", "scene", "kind", "class"]


def write(
    results: pd.DataFrame,
    folder: Path,
    clips: Iterable[ShownClip],
    methods: Sequence[str] = (),
    name: str = "where",
) -> list[Path]:
    """Write `name`.png, .pdf, .svg and a .csv of shares by scene; all clips, the first `methods`.

    Raises MissingRowsError for a method without images.
    """
    shares = error_shares(clips, methods)
    caption = (
        f"{shares['target_spp'].iloc[0]:g} spp, {describe_clips(results)}, mean over scenes. Bar: "
        "share of a row's squared error (sRGB) in pixels of a class; line: share of the pixels. A "
        "bar beyond its line: more error than elsewhere. Still: below 0.25 pixels a frame; fast: "
        "above 2. Disoccluded: not seen in the frame before; edge: next to another depth or "
        "normal. Dark: linear luminance below 0.05; bright: above 0.5."
    )
    with mpl.rc_context(style.RC):
        files = style.save_figure(draw_shares(shares, caption), folder, name)
    table = folder / f"{name}.csv"
    shares.to_csv(table, index=False)
    return [*files, table]


def error_shares(clips: Iterable[ShownClip], methods: Sequence[str] = ()) -> pd.DataFrame:
    """Columns method, target_spp, scene, kind, class, pixels, error: shares of a scene's clips.

    Shares of a kind's classes add to 1; a row without any error has the shares of its pixels.
    """
    pixels: dict[tuple[object, ...], int] = defaultdict(int)
    errors: dict[tuple[object, ...], float] = defaultdict(float)
    for clip in clips:
        rows = select_images(clip, methods, USUAL, 1, MAX_ROWS)
        classes = classify(clip.reference, clip.buffers)
        for row in rows:
            error = squared_error(row.frames, clip.reference[: len(row.frames)])
            for kind, own in classes.items():
                for index, title in enumerate(KINDS[kind]):
                    key = (row.method, row.target_spp, clip.scene, kind, title)
                    mask = own[: len(error)] == index
                    pixels[key] += int(mask.sum())
                    errors[key] += float(error[mask].sum())
    table = pd.DataFrame([(*key, pixels[key], errors[key]) for key in pixels],
                         columns=[*GROUP, "pixels", "error"])  # fmt: skip
    totals = table.groupby(GROUP[:-1])[["pixels", "error"]].transform("sum")
    shares = table[["pixels", "error"]] / totals
    return table.assign(pixels=shares["pixels"], error=shares["error"].fillna(shares["pixels"]))
