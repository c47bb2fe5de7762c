"""Validation against training: a curve for each row that was trained here, from its model card.

Command: python -m research.reports.training_curves docs/results
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure

from reports.analysis.rows import family_of
from reports.layout.curve_labels import spread_labels
from reports.layout.files import folder_argument
from reports.layout.style import RC, LineStyle, line_styles

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PACKAGES = ("baselines", "methods")
TITLES = ("ours", "rivals and controls", "the paper's recipe, and its ablations")
PAPER = "ours/paper"
PANEL, LABEL_STEP = (5.4, 6.2), 0.27  # inches: width and height of a panel, between two labels
DEPTH_DB = 5.0  # a panel reaches so far below its best end; lower starts are cut off
CAPTION = (
    "PSNR in dB, mean of 1 and 4 spp, on the validation clips of each training, which differ: "
    "compare the slopes of two rows, not their levels. Last training of each row, 128x128 pixels."
)


class Training(NamedTuple):
    """One training: the name of its row, and the curve of its validation."""

    name: str
    crops: tuple[int, ...]  # seen at each validation
    psnr: tuple[float, ...]  # dB


def shipped_cards() -> list[Path]:
    """The model cards of the weights that ship."""
    roots = (Path(str(files(package))) for package in PACKAGES)
    return sorted(path for root in roots for path in root.glob("*/cards/*.toml"))


def read_cards(paths: Iterable[Path]) -> list[Training]:
    """The trainings that the cards record, by name; published weights have none."""
    trainings = []
    for path in paths:
        card = tomllib.loads(path.read_text())
        if history := card.get("validation_history"):
            crops, psnr = zip(*history, strict=True)
            trainings.append(Training(card["name"], crops, psnr))
    return sorted(trainings)


def draw_trainings(trainings: Iterable[Training]) -> Figure:
    """Three panels: `ours`, the rivals, and the paper's recipe, each on its scale.

    Names stand beside the ends of their curves, best first.
    """
    panels: dict[str, list[Training]] = {title: [] for title in TITLES}
    for training in trainings:
        is_paper, is_ours = training.name.startswith(PAPER), family_of(training.name) == "ours"
        panels[TITLES[2 if is_paper else 0 if is_ours else 1]].append(training)
    panels = {title: chosen for title, chosen in panels.items() if chosen}
    width, height = PANEL
    with mpl.rc_context(RC):
        figure = Figure(figsize=(width * len(panels), height), layout="constrained")
        axes: Any = figure.subplots(1, len(panels), squeeze=False)[0]
        for panel, (title, chosen) in zip(axes, panels.items(), strict=True):
            panel.set_title(title, loc="left")
            panel.set_xlabel("thousand crops")
            _draw_panel(panel, chosen)
        axes[0].set_ylabel("validation PSNR [dB]")
        figure.supxlabel(CAPTION, fontsize=11, x=0.01, ha="left")
    return figure


def _draw_panel(axes: Axes, trainings: list[Training]) -> None:
    styles = line_styles(training.name for training in trainings)
    ends = {training.name: training.psnr[-1] for training in trainings}
    low = max(max(ends.values()) - DEPTH_DB, min(min(t.psnr) for t in trainings)) - 0.2
    axes.set_ylim(min(low, min(ends.values()) - 0.2), max(max(t.psnr) for t in trainings) + 0.2)
    for training in trainings:
        style = styles[training.name]
        axes.plot(
            [crops / 1e3 for crops in training.crops], training.psnr, color=style.color,
            ls=style.dash, lw=1.8, marker=style.marker, mfc=style.face, mec=style.edge, ms=6,
        )  # fmt: skip
    _write_names(axes, ends, styles)


def _write_names(axes: Axes, ends: Mapping[str, float], styles: Mapping[str, LineStyle]) -> None:
    """Write each name and its last value at the right, without overlaps."""
    low, high = axes.get_ylim()
    names = sorted(ends, key=lambda name: ends[name])
    step = (high - low) * LABEL_STEP / PANEL[1]
    heights = spread_labels([ends[name] for name in names], step, low, high)
    for name, height in zip(names, heights, strict=True):
        axes.text(
            1.03, height, f"{name} {ends[name]:.2f}", transform=axes.get_yaxis_transform(),
            va="center", fontsize=10, color=styles[name].color,
        )  # fmt: skip


def main(folder: Path) -> None:
    """Draw the cards that ship as `training.png` in `folder`."""
    figure = draw_trainings(read_cards(shipped_cards()))
    figure.savefig(folder / "training.png", dpi=150, metadata={})


if __name__ == "__main__":
    main(folder_argument("training_curves", "Draw the curves of all model cards that ship."))
