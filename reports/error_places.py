"""Where the error lives: the share of squared error by motion, visibility, geometry, luminance.

Kinds of pixels come from a clip's buffers. Conventions of clips: motion leads from a pixel to its
position one frame before, in pixels, x right and y down; depth is the distance along the view axis,
infinite for the background.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy import ndimage

from reports.analysis.images import Floats, luminance, select_images, squared_error
from reports.layout import style
from reports.layout.files import write_figure
from reports.layout.image_grid import add_caption
from reports.layout.page import describe_clips

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rlbench.benchmark.shown_clips import ShownClip

USUAL = ("ours", "accumulate/contrast", "ntas", "oidn/tuned")
GROUP = ["method", "target_spp", "scene", "kind", "class"]
STILL, FAST = 0.25, 2.0  # pixels a frame: below the first still, above the second fast
DEPTH_CHANGE = 0.1  # relative, from which two depths belong to different surfaces
NORMAL_CHANGE = 0.8  # cosine of two neighbouring normals, below which there is an edge
DARK, BRIGHT = 0.05, 0.5  # linear luminance; 1.0 is display white
KINDS = {  # title of a kind: its classes, in the order of `classify`
    "motion": ("still", "slow", "fast"),
    "visibility": ("seen before", "disoccluded"),
    "geometry": ("smooth", "edge"),
    "luminance": ("dark", "middle", "bright"),
}
Classes = NDArray[np.intp]
MAX_ROWS = 4
WIDTH, BAR, FOOTER = 13.0, 0.2, 1.75  # inches
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7")  # Okabe and Ito 2008
GAP = 0.8  # between two classes, in bars


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
    return write_figure(lambda: draw_shares(shares, caption), folder, name, shares)


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


def classify(reference: Floats, buffers: Mapping[str, Floats]) -> dict[str, Classes]:
    """The class [t h w] of each pixel for each kind that the buffers allow.

    `reference` is linear, [t 3 h w]; `buffers` may have motion, depth and normal, [t c h w]. Frame
    0 has no frame before it: its pixels are disoccluded. Without motion the camera and all objects
    stand still.
    """
    classes = {"luminance": _bands(luminance(reference), DARK, BRIGHT)}
    if "depth" in buffers or "normal" in buffers:
        classes["geometry"] = _edges(buffers).astype(np.intp)
    if "motion" in buffers:
        motion = buffers["motion"].astype(np.float32)
        classes["motion"] = _bands(np.hypot(motion[:, 0], motion[:, 1]), STILL, FAST)
        if "depth" in buffers:
            depth = buffers["depth"][:, 0].astype(np.float32)
            hidden = [_is_hidden(depth[t - 1], depth[t], motion[t]) for t in range(1, len(depth))]
            first = np.ones_like(depth[0], bool)
            classes["visibility"] = np.stack([first, *hidden]).astype(np.intp)
    return {kind: classes[kind] for kind in KINDS if kind in classes}


def _bands(values: Floats, low: float, high: float) -> Classes:
    """0 below `low`, 2 from `high` on, else 1; a motion that is not finite is fast."""
    return np.digitize(np.nan_to_num(values, nan=np.inf), [low, high])


def _is_hidden(before: Floats, now: Floats, motion: Floats) -> NDArray[np.bool_]:
    """Whether a pixel [h w] was outside of the frame before, or behind another surface."""
    height, width = now.shape
    y, x = np.indices((height, width), dtype=np.float32)
    at_x, at_y = np.rint(x + motion[0]), np.rint(y + motion[1])
    is_outside = ~((at_x >= 0) & (at_x < width) & (at_y >= 0) & (at_y < height))
    rows = np.where(is_outside, 0, at_y).astype(int)
    columns = np.where(is_outside, 0, at_x).astype(int)
    hidden: NDArray[np.bool_] = is_outside | _is_apart(before[rows, columns], now)
    return hidden


def _is_apart(depth: Floats, other: Floats) -> NDArray[np.bool_]:
    """Whether two depths differ by more than DEPTH_CHANGE; background equals background."""
    is_far, is_other_far = np.isinf(depth), np.isinf(other)
    near, far = np.where(is_far, 0, depth), np.where(is_other_far, 0, other)
    is_changed = np.abs(near - far) > DEPTH_CHANGE * np.maximum(near, far)
    apart: NDArray[np.bool_] = (is_far != is_other_far) | (~is_far & ~is_other_far & is_changed)
    return apart


def _edges(buffers: Mapping[str, Floats]) -> NDArray[np.bool_]:
    """Pixels [t h w] next to another depth or normal, and their neighbours."""
    shape = next(buffers[name].shape for name in ("depth", "normal") if name in buffers)
    found = np.zeros((shape[0], *shape[2:]), bool)
    for axis in (1, 2):
        ahead = (slice(None),) * axis + (slice(1, None),)
        behind = (slice(None),) * axis + (slice(None, -1),)
        if "depth" in buffers:
            depth = buffers["depth"][:, 0].astype(np.float32)
            found[ahead] |= _is_apart(depth[ahead], depth[behind])
        if "normal" in buffers:
            normal = np.moveaxis(buffers["normal"].astype(np.float32), 1, -1)
            found[ahead] |= (normal[ahead] * normal[behind]).sum(-1) < NORMAL_CHANGE
    cross = ndimage.generate_binary_structure(2, 1)[None]
    widened: NDArray[np.bool_] = ndimage.binary_dilation(found, cross)
    return widened


def draw_shares(shares: pd.DataFrame, caption: str) -> Figure:
    """The figure: a panel for each kind. `shares` is that of `error_shares`, by scene."""
    methods = list(dict.fromkeys(shares["method"]))
    kinds = [kind for kind in KINDS if kind in set(shares["kind"])]
    most = max(len(KINDS[kind]) for kind in kinds)
    height = BAR * most * (len(methods) + GAP) + FOOTER + 0.6
    figure = Figure(figsize=(WIDTH, height))
    panels = figure.subplots(
        1, len(kinds), squeeze=False,
        gridspec_kw={"left": 0.06, "right": 0.985, "top": 1 - 0.4 / height,
                     "bottom": FOOTER / height, "wspace": 0.42},
    )[0]  # fmt: skip
    means = shares.groupby(["method", "kind", "class"])[["pixels", "error"]].mean()
    for axes, kind in zip(panels, kinds, strict=True):
        _draw_panel(axes, means, kind, methods, most)
        axes.set_title(kind, loc="left", fontweight="bold")
        axes.set_xlabel("share of squared error")
    handles: list[Patch | Line2D] = [
        Patch(color=colour, label=method) for method, colour in zip(methods, COLOURS, strict=False)
    ]
    handles.append(Line2D([], [], color=style.BLACK, lw=1.8, label="share of the pixels"))
    figure.legend(
        handles=handles, loc="upper left", ncol=len(handles), frameon=False,
        bbox_to_anchor=(0.006, (FOOTER - 0.55) / height),
    )  # fmt: skip
    add_caption(figure, caption)
    return figure


def _draw_panel(axes: Axes, means: pd.DataFrame, kind: str, methods: list[str], most: int) -> None:
    step, errors = len(methods) + GAP, means["error"].to_dict()
    for index, name in enumerate(KINDS[kind]):
        middle = index * step + (len(methods) - 1) / 2
        for place, method in enumerate(methods):
            share = float(errors[method, kind, name])
            axes.barh(index * step + place, share, height=0.9, color=COLOURS[place])
        pixels = means.xs((kind, name), level=("kind", "class"))["pixels"].mean()
        axes.plot([pixels, pixels], [middle - step / 2 + 0.3, middle + step / 2 - 0.3],
                  color=style.BLACK, lw=1.8)  # fmt: skip
    middles = [index * step + (len(methods) - 1) / 2 for index in range(len(KINDS[kind]))]
    axes.set_yticks(middles, KINDS[kind])
    axes.set_ylim(most * step - 0.5, -0.8)
    axes.set_xlim(0, 1)
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "", "0.5", "", "1"])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
