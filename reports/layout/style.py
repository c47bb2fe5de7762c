"""How figures look: one colour a family, told apart by colour-blind readers and in grey print."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from reports.analysis.method_names import family as family_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito 2008, Color Universal Design; the proposed method has the one that stands out
COLOURS = {
    "ours": "#D55E00",
    "ntas": "#0072B2",
    "oidn": "#009E73",
    "mean": "#6B6B6B",
    "dasr": "#CC79A7",
    "imcd": "#B8860B",
    "svgf": "#56B4E9",
    "restir": "#7A4FA3",
    "oidn-intel": "#1A1A1A",
    "restir+oidn": "#4B8B3B",
    "eaw": "#8C564B",
}
SPARE = ("#B8860B", "#CC79A7", "#56B4E9", "#7A4FA3", "#8C564B", "#4B8B3B", "#20808D", "#A03050")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.2, 1.2, 1.2)))
LETTER, NARROW = 0.072, 4.0  # inches: of a letter, and of a panel in which nothing is named
INK, FAINT = "#222222", "#8A8A8A"
RC: Any = {
    "font.family": "sans-serif",
    "font.size": 12,
    "axes.titlesize": 13,
    "axes.labelsize": 12,
    "xtick.labelsize": 11,
    "ytick.labelsize": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "pdf.fonttype": 42,  # text stays text in the PDF
    "svg.fonttype": "path",  # looks the same where the font is not installed
    "svg.hashsalt": "rlbench",  # equal results give equal files
}


@dataclass(frozen=True)
class LineStyle:
    """Colour, marker and dashes of one method; markers of variants are hollow."""

    color: str
    marker: str
    dash: Any  # as matplotlib's linestyle
    face: str
    edge: str
    rim: float  # width of the marker's edge, points


def line_styles(methods: Iterable[str]) -> dict[str, LineStyle]:
    """A look for each method: colour by family, dashes and marker by variant.

    Families of the list above keep their colour in every figure; strangers get spare ones by name.
    """
    names = sorted(set(methods))
    families = list(dict.fromkeys(map(family_of, names)))
    strangers = [family for family in families if family not in COLOURS]
    free = [color for color in SPARE if color not in {COLOURS.get(f) for f in families}]
    spare = {family: free[i % len(free)] for i, family in enumerate(strangers)}
    known = list(COLOURS)
    found = {}
    for family in families:
        place = known.index(family) if family in COLOURS else len(known) + strangers.index(family)
        variants = [name for name in names if family_of(name) == family]
        for i, name in enumerate(variants):
            color = COLOURS.get(family) or spare[family]
            marker = MARKERS[(place + i) % len(MARKERS)]
            dash = DASHES[(i + i // len(MARKERS)) % len(DASHES)]  # no pair twice
            face, edge, rim = (color, "white", 0.8) if i == 0 else ("white", color, 1.5)
            found[name] = LineStyle(color, marker, dash, face, edge, rim)
    return found


def name_below(axes: Axes, points: pd.DataFrame, bottom: float) -> None:
    """Name, at the lower edge, the methods with a value below it, each with its least.

    A narrow panel says how many.
    """
    least = points.groupby("method")["value"].min()
    outside = [f"{method} from {value:.1f}" for method, value in least.items() if value < bottom]
    if outside:
        width = axes.bbox.width / axes.figure.dpi  # inches
        told = fill("below: " + ", ".join(outside), int(width / LETTER))
        told = told if width > NARROW else f"{len(outside)} below"
        axes.text(
            0.985, 0.02, told, transform=axes.transAxes, ha="right", fontsize=9.5, color=FAINT,
            zorder=4, bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
        )  # fmt: skip


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """PNG at 150 dpi, PDF and SVG of a figure, without dates, so that equal figures are equal."""
    folder.mkdir(parents=True, exist_ok=True)
    undated = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
    files = [folder / f"{name}.{kind}" for kind in undated]
    for file, metadata in zip(files, undated.values(), strict=True):
        figure.savefig(file, dpi=150, metadata=metadata)
    return files


def slug(text: str) -> str:
    """Text as part of a file name."""
    return "-".join("".join(c if c.isalnum() else " " for c in text.lower()).split())
