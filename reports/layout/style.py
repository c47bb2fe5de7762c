"""Style of the figures: a colour for each family, distinct for colour-blind readers and in grey."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Any

from reports.analysis.rows import family_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


# Okabe and Ito 2008, Color Universal Design; the proposed method has the most salient colour
FAMILY_COLOURS = {
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
    "nppd": "#20808D",
    "accumulate": "#A03050",
    "bmfr": "#6B8E23",
    "cross": "#3B4CC0",
}
SPARE_COLOURS = (  # of families that are not listed above
    "#B8860B", "#CC79A7", "#56B4E9", "#7A4FA3", "#8C564B", "#4B8B3B", "#20808D",
)  # fmt: skip
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">", "p", "h", "d", "8", "H")
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.2, 1.2, 1.2)))
LETTER_WIDTH = 0.072  # inches
NARROW_PANEL = 4.0  # inches; a narrower panel names no method
BLACK, GREY = "#222222", "#8A8A8A"
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
    """Colour, marker and dashes of one method; the markers of variants are hollow."""

    color: str
    marker: str
    dash: Any  # as matplotlib's linestyle
    face: str
    edge: str
    edge_width: float  # of the marker, points


def line_styles(methods: Iterable[str]) -> dict[str, LineStyle]:
    """A style for each method: the colour by family, dashes and marker by variant.

    Families in FAMILY_COLOURS have the same colour in every figure; others get spare colours in
    the order of their names. No two methods share a marker while there are enough markers.
    """
    names = sorted(set(methods))
    present = set(map(family_of, names))
    unlisted = sorted(present - set(FAMILY_COLOURS))
    used = {FAMILY_COLOURS.get(family) for family in present}
    free = [color for color in SPARE_COLOURS if color not in used] or SPARE_COLOURS
    spare = {family: free[i % len(free)] for i, family in enumerate(unlisted)}
    order = [*FAMILY_COLOURS, *unlisted]
    families = {f: [name for name in names if family_of(name) == f] for f in present}
    variants = {name: families[family_of(name)].index(name) for name in names}
    styles: dict[str, LineStyle] = {}
    for name in sorted(names, key=lambda name: (variants[name], order.index(family_of(name)))):
        family, i = family_of(name), variants[name]
        color = FAMILY_COLOURS.get(family) or spare[family]
        marker, dash = _free_marker(order.index(family) + i, i, styles.values())
        face, edge, width = (color, "white", 0.8) if i == 0 else ("white", color, 1.5)
        styles[name] = LineStyle(color, marker, dash, face, edge, width)
    return {name: styles[name] for name in names}


def _free_marker(first: int, variant: int, styles: Iterable[LineStyle]) -> tuple[str, Any]:
    """The marker and the dashes that fewest methods have, from a preferred place on."""
    markers = [MARKERS[(first + i) % len(MARKERS)] for i in range(len(MARKERS))]
    dashes = [DASHES[(variant + i) % len(DASHES)] for i in range(len(DASHES))]
    uses = Counter(style.marker for style in styles)
    marker = min(markers, key=lambda marker: uses[marker])
    beside = Counter(str(style.dash) for style in styles if style.marker == marker)
    return marker, min(dashes, key=lambda dash: beside[str(dash)])


def wrap_lines(caption: str, letters: int) -> str:
    """The caption, each of whose lines is broken before it exceeds so many letters."""
    return "\n".join(fill(line, letters) for line in caption.splitlines())


def note_hidden_points(axes: Axes, points: pd.DataFrame, bottom: float) -> None:
    """Name, at the lower edge, the methods with values below `bottom`, each with its lowest.

    In a narrow panel the note is only their number.
    """
    lowest = points.groupby("method")["value"].min()
    hidden = [f"{method} from {value:.1f}" for method, value in lowest.items() if value < bottom]
    if hidden:
        width = axes.bbox.width / axes.figure.dpi  # inches
        text = fill("below the axis: " + ", ".join(hidden), int(width / LETTER_WIDTH))
        text = text if width > NARROW_PANEL else f"{len(hidden)} below the axis"
        axes.text(
            0.985, 0.02, text, transform=axes.transAxes, ha="right", fontsize=9.5, color=GREY,
            zorder=4, bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
        )  # fmt: skip
