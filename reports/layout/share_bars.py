"""Bars of shares of error by class of pixel, with the share of the pixels marked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from reports.analysis.places import KINDS
from reports.layout import style
from reports.layout.image_grid import add_caption

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MAX_ROWS", "draw_shares"]

MAX_ROWS = 4
WIDTH, BAR, FOOTER = 13.0, 0.2, 1.75  # inches
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7")  # Okabe and Ito 2008
GAP = 0.8  # between two classes, in bars


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
