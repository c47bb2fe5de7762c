"""The known-optimum figure: what share of the optimal error reduction each way to train reaches.

Command: python -m reports.known_optimum docs, after python -m
methods.ours.experiments.compare_learners --out docs
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from reports.layout.style import FAINT, INK, RC

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TABLE = "known_optimum"
MARKS = ("<!-- table -->", "<!-- /table -->")
LOWEST = -0.35  # of the axis; what lies below is drawn at its edge
LOOKS = {  # colour and dashes; the proposed default has the one that stands out
    "true gradient": (INK, (0, (1, 1.5))),
    "reinforce+surrogate": ("#D55E00", "-"),
    "reinforce": ("#E69F00", "-"),
    "critic": ("#0072B2", "-"),
    "surrogate": ("#009E73", "-"),
    "gamma": ("#CC79A7", "-"),
    "rllib-appo": ("#7A4FA3", "-"),
    "reinforce, no price": ("#E69F00", (0, (4, 2))),
    "reinforce, single pixels": ("#E69F00", (0, (1, 1))),
    "rllib-appo, joint ratio": ("#7A4FA3", (0, (4, 2))),
}
FORMER_NAMES = {  # learners in tables that were written before
    "ppo-pixel": "reinforce",
    "ppo-pixel+surrogate": "reinforce+surrogate",
    "ppo-pixel, no price": "reinforce, no price",
    "ppo-pixel, single pixels": "reinforce, single pixels",
}
TITLES = {
    "direct": "pixels judged as they are",
    "filter": "pixels coupled by a 5x5 filter",
}


def curves(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean, least and greatest score over seeds, at each point of each training."""
    rows = rows.assign(
        point=rows.groupby(["learner", "mode", "seed"]).cumcount(),
    )
    by = rows.groupby(["learner", "mode", "point"], sort=False)
    return by.agg(
        frames=("frames", "mean"),
        seconds=("seconds", "mean"),
        score=("score", "mean"),
        least=("score", "min"),
        greatest=("score", "max"),
    ).reset_index()


def table(rows: pd.DataFrame) -> str:
    """Markdown: the last score of each learner in both modes, mean and range over seeds."""
    last = rows.groupby(["learner", "mode", "seed"]).last().reset_index()
    best = rows.groupby(["learner", "mode", "seed"])["score"].max().reset_index()
    modes = [mode for mode in TITLES if mode in set(last["mode"])]
    head = ["learner", *(f"{mode} {what}" for mode in modes for what in ("at the end", "best"))]
    lines = ["| " + " | ".join([*head, "frames", "CPU s", "seeds"]) + " |"]
    lines.append("| --- |" + " ---: |" * (len(head) + 2))
    for name in (n for n in LOOKS if n in set(last["learner"])):
        mine, cells = last[last["learner"] == name], [name]
        for mode in modes:
            end = mine.loc[mine["mode"] == mode, "score"]
            top = best.loc[(best["learner"] == name) & (best["mode"] == mode), "score"]
            cells += [_range(end), f"{top.mean():.2f}" if len(top) else "-"]
        cells += [f"{mine['frames'].max()}", f"{mine['seconds'].mean():.0f}"]
        lines.append("| " + " | ".join([*cells, str(mine["seed"].nunique())]) + " |")
    return "\n".join(lines) + "\n"


def _range(scores: pd.Series[float]) -> str:
    if scores.empty:
        return "-"
    if len(scores) == 1:
        return f"{scores.mean():.2f}"
    return f"{scores.mean():.2f} ({scores.min():.2f} to {scores.max():.2f})"


def draw(rows: pd.DataFrame, file: Path) -> None:
    """PNG: score against frames above, against seconds below, one column a mode."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    seen = curves(rows)
    modes = [mode for mode in TITLES if mode in set(seen["mode"])]
    with mpl.rc_context(RC):
        figure = Figure(figsize=(6.2 * len(modes), 8.4), layout="constrained")
        FigureCanvasAgg(figure)
        grid: Any = figure.subplots(2, len(modes), sharey=True, squeeze=False)
        for column, mode in enumerate(modes):
            for axes, across in zip(grid[:, column], ("frames", "seconds"), strict=True):
                _panel(axes, seen[seen["mode"] == mode], across)
            grid[0, column].set_title(TITLES[mode])
            grid[1, column].set_xscale("log")
            grid[1, column].xaxis.set_major_formatter("{x:g}")
            grid[0, column].set_xlabel("frames seen in training")
            grid[1, column].set_xlabel("seconds of one CPU core (shared machine)")
        for axes in grid[:, 0]:
            axes.set_ylabel("share of the optimal error reduction")
        shown = [axes.get_legend_handles_labels() for axes in grid[0]]
        known = {k: v for handles, names in shown for k, v in zip(names, handles, strict=True)}
        labels = [name for name in LOOKS if name in known]
        handles = [known[name] for name in labels]
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
        figure.savefig(file, dpi=150, metadata={})


def _panel(axes: Axes, seen: pd.DataFrame, across: str) -> None:
    axes.axhline(0, color=FAINT, linewidth=1)
    axes.axhline(1, color=FAINT, linewidth=1)
    for text, score in (("uniform", 0), ("optimum", 1)):
        where: Any = ("axes fraction", "data")
        axes.annotate(text, (1.01, score), xycoords=where, color=FAINT, va="center", fontsize=10)
    for name, (color, dash) in LOOKS.items():
        mine = seen[seen["learner"] == name]
        if mine.empty:
            continue
        low, middle, high = (mine[k].clip(lower=LOWEST) for k in ("least", "score", "greatest"))
        axes.fill_between(mine[across], low, high, color=color, alpha=0.12, linewidth=0)
        axes.plot(mine[across], middle, color=color, linestyle=dash, linewidth=2, label=name)
    axes.set_ylim(LOWEST - 0.02, 1.08)


def main(folder: Path) -> None:
    """Read the table in `folder`, write the figure beside it, print the table in Markdown.

    A page of the same name, with the marks between which a table belongs, gets it too.
    """
    rows = pd.read_csv(folder / f"{TABLE}.csv").replace({"learner": FORMER_NAMES})
    draw(rows, folder / f"{TABLE}.png")
    sys.stdout.write(table(rows))
    page = folder / f"{TABLE}.md"
    if page.exists():
        text = page.read_text()
        begin, end = (text.index(mark) for mark in MARKS)
        page.write_text(text[: begin + len(MARKS[0])] + "\n" + table(rows) + text[end:])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m reports.known_optimum",
        description=f"Draw FOLDER/{TABLE}.csv, which "
        "python -m methods.ours.experiments.compare_learners writes.",
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("docs"))
    main(parser.parse_args().folder)
