"""The known-optimum figure: share of the optimal error reduction that each learner reaches.

Command: python -m reports.known_optimum docs/results, after python -m
methods.ours.experiments.compare_learners --out docs/results
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from reports.layout.style import BLACK, GREY, RC

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["average_seeds", "draw_figure", "main", "markdown_table", "read_rows"]

NAME = "known_optimum"  # of the CSV and the figure
LOWEST_SCORE = -0.35  # of the axis; lower scores are drawn at its edge
LINE_STYLES = {  # colour and dashes; the proposed default has the most salient colour
    "true gradient": (BLACK, (0, (1, 1.5))),
    "reinforce+surrogate": ("#D55E00", "-"),
    "reinforce": ("#E69F00", "-"),
    "critic": ("#0072B2", "-"),
    "surrogate": ("#009E73", "-"),
    "gamma": ("#CC79A7", "-"),
    "stochastic": ("#56B4E9", "-"),
    "rllib-appo": ("#7A4FA3", "-"),
    "reinforce, no price": ("#E69F00", (0, (4, 2))),
    "reinforce, single pixels": ("#E69F00", (0, (1, 1))),
    "stochastic, single pixels": ("#56B4E9", (0, (1, 1))),
    "rllib-appo, joint ratio": ("#7A4FA3", (0, (4, 2))),
}
TITLES = {  # of the modes of the problem
    "direct": "independent pixels",
    "filter": "pixels coupled by a 5x5 filter",
}
TRAINING = ["learner", "mode", "seed"]  # columns that identify a training


def read_rows(file: Path) -> pd.DataFrame:
    """The CSV that `compare_learners` wrote."""
    return pd.read_csv(file)


def average_seeds(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean, lowest and highest score over seeds, at each evaluation of each training."""
    rows = rows.assign(point=rows.groupby(TRAINING).cumcount())
    groups = rows.groupby(["learner", "mode", "point"], sort=False)
    return groups.agg(
        frames=("frames", "mean"),
        seconds=("seconds", "mean"),
        score=("score", "mean"),
        lowest=("score", "min"),
        highest=("score", "max"),
    ).reset_index()


def markdown_table(rows: pd.DataFrame) -> str:
    """The last and best score of each learner in both modes: mean and range over seeds."""
    last = rows.groupby(TRAINING).last().reset_index()
    best = rows.groupby(TRAINING)["score"].max().reset_index()
    modes = [mode for mode in TITLES if mode in set(last["mode"])]
    scores = [f"{mode} {when}" for mode in modes for when in ("at the end", "best")]
    lines = ["| " + " | ".join(["learner", *scores, "frames", "CPU s", "seeds"]) + " |"]
    lines.append("| --- |" + " ---: |" * (len(scores) + 3))
    for name in (n for n in LINE_STYLES if n in set(last["learner"])):
        learner, cells = last[last["learner"] == name], [name]
        for mode in modes:
            end = learner.loc[learner["mode"] == mode, "score"]
            top = best.loc[(best["learner"] == name) & (best["mode"] == mode), "score"]
            cells += [_format_range(end), f"{top.mean():.2f}" if len(top) else "-"]
        cells += [f"{learner['frames'].max()}", f"{learner['seconds'].mean():.0f}"]
        lines.append("| " + " | ".join([*cells, str(learner["seed"].nunique())]) + " |")
    return "\n".join(lines) + "\n"


def _format_range(scores: pd.Series[float]) -> str:
    if scores.empty:
        return "-"
    if len(scores) == 1:
        return f"{scores.mean():.2f}"
    return f"{scores.mean():.2f} ({scores.min():.2f} to {scores.max():.2f})"


def draw_figure(rows: pd.DataFrame, file: Path) -> None:
    """Write a PNG: score against frames above, against seconds below, a column per mode."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    curves = average_seeds(rows)
    modes = [mode for mode in TITLES if mode in set(curves["mode"])]
    with mpl.rc_context(RC):
        figure = Figure(figsize=(6.2 * len(modes), 8.4), layout="constrained")
        FigureCanvasAgg(figure)
        grid: Any = figure.subplots(2, len(modes), sharey=True, squeeze=False)
        for column, mode in enumerate(modes):
            for axes, x in zip(grid[:, column], ("frames", "seconds"), strict=True):
                _draw_panel(axes, curves[curves["mode"] == mode], x)
            grid[0, column].set_title(TITLES[mode])
            grid[1, column].set_xscale("log")
            grid[1, column].xaxis.set_major_formatter("{x:g}")
            grid[0, column].set_xlabel("frames seen in training")
            grid[1, column].set_xlabel("seconds of one CPU core (shared machine)")
        for axes in grid[:, 0]:
            axes.set_ylabel("share of the optimal error reduction")
        _add_key(figure, grid[0])
        figure.savefig(file, dpi=150, metadata={})


def _add_key(figure: Figure, panels: Sequence[Axes]) -> None:
    """One key for all panels, in the order of LINE_STYLES."""
    handles: dict[str, Any] = {}
    for axes in panels:
        lines, names = axes.get_legend_handles_labels()
        handles |= dict(zip(names, lines, strict=True))
    names = [name for name in LINE_STYLES if name in handles]
    lines = [handles[name] for name in names]
    figure.legend(lines, names, loc="outside lower center", ncols=4, frameon=False)


def _draw_panel(axes: Axes, curves: pd.DataFrame, x: str) -> None:
    axes.axhline(0, color=GREY, linewidth=1)
    axes.axhline(1, color=GREY, linewidth=1)
    for text, score in (("uniform", 0), ("optimum", 1)):
        coordinates: Any = ("axes fraction", "data")
        axes.annotate(
            text, (1.01, score), xycoords=coordinates, color=GREY, va="center", fontsize=10
        )
    for name, (color, dash) in LINE_STYLES.items():
        curve = curves[curves["learner"] == name]
        if curve.empty:
            continue
        scores = curve[["lowest", "score", "highest"]].clip(lower=LOWEST_SCORE)
        axes.fill_between(
            curve[x], scores["lowest"], scores["highest"], color=color, alpha=0.12, linewidth=0
        )
        axes.plot(curve[x], scores["score"], color=color, linestyle=dash, linewidth=2, label=name)
    axes.set_ylim(LOWEST_SCORE - 0.02, 1.08)


def main(folder: Path) -> None:
    """Read the CSV in `folder`, write the figure beside it, print the table in Markdown."""
    rows = read_rows(folder / f"{NAME}.csv")
    draw_figure(rows, folder / f"{NAME}.png")
    sys.stdout.write(markdown_table(rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m reports.known_optimum",
        description=f"Draw FOLDER/{NAME}.csv, a table of "
        "python -m methods.ours.experiments.compare_learners.",
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("docs/results"))
    main(parser.parse_args().folder)
