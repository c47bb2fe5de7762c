"""The gradient figures: direction, scale and noise of estimators, and saturated importance ratios.

Command: python -m research.reports.gradients docs/results, after python -m
methods.ours.gradients.measure --out docs/results
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import pandas as pd

from reports.layout.files import drawn_png, folder_argument
from reports.layout.style import BLACK, GREY
from reports.layout.tables import pipe_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GRADIENTS, RATIOS = "gradients", "importance_ratio"  # of the CSVs and the figures
DOTTED, DASHED = (0, (1, 1.5)), (0, (4, 2))
LINE_STYLES = {  # colour and dashes; colours as in the figure of the known optimum
    "explored truth": (BLACK, DOTTED),
    "surrogate": ("#009E73", "-"),
    "surrogate per sample": ("#009E73", DASHED),
    "gamma": ("#CC79A7", "-"),
    "reinforce": ("#E69F00", "-"),
    "reinforce, no price": ("#E69F00", DASHED),
    "stochastic": ("#56B4E9", "-"),
    "stochastic, single pixels": ("#56B4E9", DASHED),
    "score function": ("#0072B2", "-"),
    "score function, no baseline": ("#0072B2", DASHED),
}
REFERENCES = ("explored truth",)  # have no noise of samples
UNDRAWN = ("relaxed truth", "reinforce+surrogate")  # nearly 1; nearly `reinforce`
RATIO_COLOURS = {"joint": "#7A4FA3", "block": "#E69F00", "pixel": "#0072B2"}
TABLE_BUDGETS = (0.5, 4.0, 64.0)  # samples per pixel
PLAIN, WEIGHTED = "no filter", "count-weighted filter"


class Panel(NamedTuple):
    """One row of panels: a column of the table against the budget."""

    column: str
    label: str
    is_log: bool
    ideal: float | None
    limits: tuple[float, float]


PANELS = (
    Panel("cosine", "cosine to the true gradient", False, 1, (0.2, 1.03)),
    Panel("scale", "length along it / true length", True, 1, (0.02, 25)),
    Panel("frames", "frames until noise = signal (▲: more)", True, None, (0.05, 2e4)),
)


def draw_gradients(rows: pd.DataFrame, file: Path) -> None:
    """Write a PNG: cosine, scale and noise against the budget, a column per denoiser."""
    denoisers = list(rows["denoiser"].unique())
    with drawn_png(file, (4.6 * len(denoisers), 10.5), 130) as figure:
        grid: Any = figure.subplots(
            len(PANELS), len(denoisers), sharex=True, sharey="row", squeeze=False
        )
        for line, panel in zip(grid, PANELS, strict=True):
            for axes, denoiser in zip(line, denoisers, strict=True):
                _draw_panel(axes, rows[rows["denoiser"] == denoiser], panel)
            line[0].set_ylabel(panel.label)
        for axes, denoiser in zip(grid[0], denoisers, strict=True):
            axes.set_title(denoiser)
        for axes in grid[-1]:
            axes.set_xlabel("samples per pixel")
        lines, names = grid[0, 0].get_legend_handles_labels()
        figure.legend(lines, names, loc="outside lower center", ncols=3, frameon=False)


def _draw_panel(axes: Axes, rows: pd.DataFrame, panel: Panel) -> None:
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter("{x:g}")
    if panel.is_log:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylim(*panel.limits)
    if panel.ideal is not None:
        axes.axhline(panel.ideal, color=GREY, linewidth=1)
    for name, (color, dash) in LINE_STYLES.items():
        if panel.column == "frames" and name in REFERENCES:
            continue
        curve = rows[rows["estimator"] == name]
        spp, values = curve["spp"], curve[panel.column].where(_is_drawn(curve, panel.column))
        axes.plot(spp, values, "o", color=color, linestyle=dash, markersize=3, label=name)
        if panel.column == "cosine":
            low = (values - curve["cosine_margin"]).clip(lower=-1)
            high = (values + curve["cosine_margin"]).clip(upper=1)
            axes.fill_between(spp, low, high, color=color, alpha=0.12, linewidth=0)
        if panel.column == "frames":
            bounds = _least_frames(curve).where(~_has_length(curve))
            axes.plot(spp, bounds, "^", color=color, markersize=5, fillstyle="none")


def _is_drawn(rows: pd.DataFrame, column: str) -> pd.Series[bool]:
    """True if the value is known, and means anything."""
    if column == "cosine":
        return rows["cosine"].notna()
    return _has_length(rows) & (rows["has_scale"] | (column == "frames"))


def _has_length(rows: pd.DataFrame) -> pd.Series[bool]:
    """True if the component along the truth is larger than its interval."""
    return rows["scale"].abs() > rows["scale_margin"]


def _least_frames(rows: pd.DataFrame) -> pd.Series[float]:
    """Frames until noise = signal if the component is at the upper end of its interval."""
    scale = rows["scale"].abs()
    return rows["frames"] * (scale / (scale + rows["scale_margin"])) ** 2


def draw_ratios(rows: pd.DataFrame, file: Path) -> None:
    """Write a PNG: share of ratios outside the clip range against the side of the image."""
    with drawn_png(file, (7.5, 4.6), 130) as figure:
        axes = figure.subplots()
        for (ratio, step), curve in _by_ratio_and_step(rows):
            dash: Any = "-" if step.startswith("Adam") else DOTTED
            axes.plot(
                curve["side"], curve["clipped"], "o", color=RATIO_COLOURS[ratio], linestyle=dash,
                markersize=4, label=f"{ratio}, {step}",
            )  # fmt: skip
        axes.set_xscale("log", base=2)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlabel("rows and columns of the image")
        axes.set_ylabel("ratios outside 1 ± 0.15 after one step")
        figure.legend(loc="outside right center", frameon=False)


def _by_ratio_and_step(rows: pd.DataFrame) -> Iterator[tuple[tuple[str, str], pd.DataFrame]]:
    for key, curve in rows.groupby(["ratio", "step"], sort=False):
        ratio, step = cast("tuple[str, str]", key)
        yield (ratio, step), curve


def gradient_table(rows: pd.DataFrame) -> str:
    """Cosine, scale and noise of each estimator at TABLE_BUDGETS, as Markdown.

    "?" is hidden by noise, and ">" a lower bound for the same reason.
    """
    budgets = " / ".join(f"{spp:g}" for spp in TABLE_BUDGETS)
    lines = []
    for name in rows["estimator"].unique():
        own = rows[rows["estimator"] == name]
        cells = [_cells(own, PLAIN, "cosine"), _cells(own, WEIGHTED, "cosine")]
        cells += [_cells(own, PLAIN, "scale") if own["has_scale"].all() else "any"]
        cells += [_cells(own, PLAIN, "frames"), _cells(own, WEIGHTED, "frames")]
        lines.append([name, *cells])
    both = (PLAIN, WEIGHTED)
    titles = [*(f"cosine, {name}" for name in both), f"length, {PLAIN}"]
    titles += [f"frames, {name}" for name in both]
    return pipe_table([f"at {budgets} spp", *titles], lines)


def _cells(rows: pd.DataFrame, denoiser: str, column: str) -> str:
    chosen = rows[rows["denoiser"] == denoiser].set_index("spp").reindex(TABLE_BUDGETS)
    if column == "frames":
        known, least = _has_length(chosen), _least_frames(chosen)
        pairs = zip(known, chosen["frames"].where(known, least), strict=True)
        return " / ".join(("" if is_known else ">") + _frames(value) for is_known, value in pairs)
    values = chosen[column].where(_is_drawn(chosen, column))
    return " / ".join("?" if pd.isna(value) else f"{value:.2f}" for value in values)


def _frames(value: float) -> str:
    return f"{value:,.0f}" if value >= 9.5 else f"{value:.1f}"


def ratio_table(rows: pd.DataFrame) -> str:
    """Share of ratios outside the clip range, a line per ratio and step, as Markdown."""
    sides = sorted(rows["side"].unique())
    lines = []
    for (ratio, step), own in _by_ratio_and_step(rows):
        shares = own.set_index("side")["clipped"].reindex(sides)
        lines.append([f"{ratio}, {step}", *(f"{share:.0%}" for share in shares)])
    return pipe_table(["ratio, step", *(f"{side}x{side}" for side in sides)], lines)


def main(folder: Path) -> None:
    """Read both CSVs in `folder`, write the figures beside them, print the tables in Markdown."""
    gradients, ratios = (pd.read_csv(folder / f"{name}.csv") for name in (GRADIENTS, RATIOS))
    draw_gradients(gradients, folder / f"{GRADIENTS}.png")
    draw_ratios(ratios, folder / f"{RATIOS}.png")
    sys.stdout.write(gradient_table(gradients) + "\n" + ratio_table(ratios))


if __name__ == "__main__":
    about = f"Draw FOLDER/{GRADIENTS}.csv and FOLDER/{RATIOS}.csv of the experiment `gradients`."
    main(folder_argument("gradients", about))
