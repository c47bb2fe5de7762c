"""The known-optimum figure: share of the optimal error reduction that each learner reaches.

Command: python -m research.reports.known_optimum docs/results, after python -m
methods.ours.gradients.compare_learners --out docs/results
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from reports.layout.files import drawn_png, folder_argument
from reports.layout.style import BLACK, GREY
from reports.layout.tables import pipe_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    lines = []
    for name in (n for n in LINE_STYLES if n in set(last["learner"])):
        learner, cells = last[last["learner"] == name], [name]
        for mode in modes:
            end = learner.loc[learner["mode"] == mode, "score"]
            top = best.loc[(best["learner"] == name) & (best["mode"] == mode), "score"]
            cells += [_format_range(end), f"{top.mean():.2f}" if len(top) else "-"]
        cells += [f"{learner['frames'].max()}", f"{learner['seconds'].mean():.0f}"]
        lines.append([*cells, str(learner["seed"].nunique())])
    return pipe_table(["learner", *scores, "frames", "CPU s", "seeds"], lines)


def _format_range(scores: pd.Series[float]) -> str:
    if scores.empty:
        return "-"
    if len(scores) == 1:
        return f"{scores.mean():.2f}"
    return f"{scores.mean():.2f} ({scores.min():.2f} to {scores.max():.2f})"


def draw_figure(rows: pd.DataFrame, file: Path) -> None:
    """Write a PNG: score against frames above, against seconds below, a column per mode."""
    curves = average_seeds(rows)
    modes = [mode for mode in TITLES if mode in set(curves["mode"])]
    with drawn_png(file, (6.2 * len(modes), 8.4)) as figure:
        grid: Any = figure.subplots(2, len(modes), sharey=True, squeeze=False)
        handles: dict[str, Any] = {}
        for (above, below), mode in zip(grid.T, modes, strict=True):
            for axes, x in ((above, "frames"), (below, "seconds")):
                _draw_panel(axes, curves[curves["mode"] == mode], x)
            above.set_title(TITLES[mode])
            below.set_xscale("log")
            below.xaxis.set_major_formatter("{x:g}")
            above.set_xlabel("frames seen in training")
            below.set_xlabel("seconds of one CPU core (shared machine)")
            lines, names = above.get_legend_handles_labels()
            handles |= dict(zip(names, lines, strict=True))
        for axes in grid[:, 0]:
            axes.set_ylabel("share of the optimal error reduction")
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
    rows = pd.read_csv(folder / f"{NAME}.csv")
    draw_figure(rows, folder / f"{NAME}.png")
    sys.stdout.write(markdown_table(rows))


if __name__ == "__main__":
    main(folder_argument("known_optimum", f"Draw FOLDER/{NAME}.csv of the experiment."))
