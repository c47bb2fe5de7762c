"""The Pareto plot: score against frame time, a curve over budgets for each method.

Names stand beside the curves, and the dominated area is grey.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from reports.analysis.rows import ReportError
from reports.analysis.scores import ENDS, Scores
from reports.layout import style
from reports.layout.curve_labels import LABEL_DISTANCE, label_curves, label_width, longest_rise
from reports.layout.page import Drawing, describe_clips, write_figures
from reports.layout.style import LineStyle
from reports.layout.tables import score_name, uncertainty_of
from rlbench.benchmark.results import WIDE, MissingRowsError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOG_RATIO = 3.0  # values that span a larger factor get a logarithmic axis
WINDOW_DB = 10.0  # below the best score, that a panel shows
UNCERTAIN, PALE = "bar: interval of an uncertain time", 0.45  # opacity
MAX_PANELS = 8  # with more scenes, only their mean is drawn
WIDTH, HEIGHT = 13.0, 5.4  # inches; keys and caption come on top; many names need more height
LEADER, GAP = 0.4, 0.75  # inches: from the first panel to names beside it, from these to an axis
OVERALL = "mean of all scenes"
HEADING_LETTERS, CAPTION_LETTERS = 150, 155  # in a line
FEW_TICKS = 5  # on an axis that spans less than this factor
Range = tuple[float, float]
DOMINATED, DOMINATED_COLOUR = "slower and worse than another", "#EFEFEF"


def write(
    results: pd.DataFrame, folder: Path, metric: str = "psnr", name: str = "pareto"
) -> list[Path]:
    """Write the plot and a CSV of its points, see `write_figures`.

    Frame time = gbuffer + plan + allocate + sampling + denoise. Points without a score or time are
    not plotted; those with an uncertain time are pale, with a bar. Raises MissingRowsError if no
    point is left.
    """
    return write_figures(results, folder, name, _figures, metric)


def _figures(scores: Scores) -> dict[str, Drawing]:
    points = plotted_points(scores)
    return {"": (partial(draw_pareto, points, figure_labels(scores)), points)}


@dataclass(frozen=True)
class Labels:
    """The texts of the figure."""

    score: str  # name and unit
    direction: str  # "higher" or "lower" is better, or empty
    caption: str
    heading: str = ""  # above the panels


def plotted_points(scores: Scores) -> pd.DataFrame:
    """The rows of `scores.points` that have a frame time, and their means over scenes.

    `uncertain` is true for points whose time has a wide interval, `front` for those on the Pareto
    front of their panel. Raises MissingRowsError if no point has a time, and ReportError if there
    are too many scenes for panels and no mean over them.
    """
    per_scene = scores.points
    mean = scores.overall.assign(scene=OVERALL)
    points = pd.concat([mean, per_scene], ignore_index=True)[per_scene.columns]
    points = points[points["frame_ms"].notna()].reset_index(drop=True)
    _check_points(points, scores)
    points["uncertain"] = [uncertainty_of(row) > WIDE for row in points.to_dict("records")]
    points["front"] = False
    for _, panel in points.groupby("scene"):
        front = pareto_front(panel["frame_ms"], panel["value"], scores.direction)
        points.loc[panel.index[front], "front"] = True
    return points


def pareto_front(times: pd.Series, values: pd.Series, direction: str) -> list[int]:
    """Positions of the points on the Pareto front of time and score, in order of time.

    Low times are better; of the values, the `higher` or `lower` ones.

    >>> pareto_front(pd.Series([1.0, 2.0, 3.0]), pd.Series([5.0, 4.0, 6.0]), "higher")
    [0, 2]
    """
    sign = -1 if direction == "lower" else 1
    order = sorted(range(len(times)), key=lambda i: (times.iloc[i], -sign * values.iloc[i]))
    front: list[int] = []
    for i in order:
        if not front or sign * values.iloc[i] > sign * values.iloc[front[-1]]:
            front.append(i)
    return front


def figure_labels(scores: Scores) -> Labels:
    """Axis label and caption of one device's figure."""
    metric, unit = scores.metric, scores.column_text("unit")
    title = score_name(metric)
    caption = (
        f"{title}: {scores.convention}; {describe_clips(scores.measured)}. "
        f"Frame time: plan + allocate + denoise on {scores.device_name} + G-buffer "
        "+ drawn samples per pixel x time of one sample per pixel "
        f"({scores.cost_source or 'not named'})."
    )
    label = f"{title} [{unit}]" if unit else title
    everyone = set(scores.measured["method"])
    heading = "; ".join(
        f"Two devices: {devices}" + ("" if everyone <= set(names) else f" ({', '.join(names)})")
        for devices, names in scores.device_mixes.items()
    )
    heading = heading or scores.place
    return Labels(label, scores.direction, caption + _missing_methods(scores), heading)


def _check_points(points: pd.DataFrame, scores: Scores) -> None:
    if points.empty:
        rows = scores.rows
        measured = sorted(set(rows.loc[rows["value"].notna(), "metric"])) or ["nothing"]
        raise MissingRowsError(
            f"no method has all of {scores.metric}, plan_ms, denoise_ms and sample_ms on a scene; "
            f"the results have {', '.join(measured)}. Measure times with rlbench run; its option "
            "--cost takes sample_ms from a published profile"
        )
    scenes = points["scene"].nunique()
    if OVERALL not in set(points["scene"]) and scenes > MAX_PANELS:
        raise ReportError(
            f"no method has {scores.metric} and times at one budget on each of {scenes} scenes, so "
            f"there is no mean to plot, and more than {MAX_PANELS} scenes have no panels; plot "
            "fewer scenes"
        )


def _missing_methods(scores: Scores) -> str:
    """Caption lines with the methods that have scores but no mean over scenes, or no time."""
    points = scores.points
    untimed = set(points.loc[points["frame_ms"].isna(), "method"])
    averaged = scores.overall.groupby("method")["target_spp"].nunique()
    measured = scores.measured.groupby("method")["target_spp"].nunique()
    partial = {method for method, count in measured.items() if averaged.get(method, 0) < count}
    missing = {
        "Not on every scene and frame": partial,
        "Without a time on every scene": untimed,
    }
    lines = [f"{title}: {', '.join(sorted(who))}." for title, who in missing.items() if who]
    return "".join(f"\n{line}" for line in (*lines, *filter(None, [scores.remark_on_times])))


def draw_pareto(plotted: pd.DataFrame, labels: Labels) -> Figure:
    """The figure: the mean over scenes at the left, a panel per scene at the right, keys below.

    A single scene has the only panel. With more than MAX_PANELS scenes only their mean is drawn.
    The names of the methods stand beside the first panel, in the order of the ends of their curves.
    """
    names = set(plotted["scene"])
    scenes = sorted(names - {OVERALL})
    single = scenes if len(scenes) <= MAX_PANELS else []
    scenes = [*names & {OVERALL}, *single] if len(scenes) > 1 else scenes
    styles = style.line_styles(plotted["method"])
    height = max(HEIGHT, LABEL_DISTANCE * 1.3 * len(styles))
    caption = style.wrap_lines(labels.caption, CAPTION_LETTERS)
    footer = 1.62 + 0.17 * (caption.count("\n") - 1)  # inches for keys and caption
    figure = Figure(figsize=(WIDTH, height + footer))
    heading = fill(labels.heading, HEADING_LETTERS)
    top = 0.95 - 0.035 * len(heading.splitlines())
    number = ".2f" if "dB" in labels.score else ".3g"
    named = plotted.loc[plotted["scene"] == scenes[0], ["method", "value"]]
    beside = LEADER + label_width(named.to_numpy(), number)
    panels = _add_panels(figure, scenes, beside, footer / (height + footer), top)
    figure.text(0.012, 0.985, heading, fontsize=12, fontweight="bold", color=style.BLACK, va="top")
    budgets = sorted(set(plotted["target_spp"]))  # markers grow with them
    sizes = {spp: 26 + 95 * i / max(len(budgets) - 1, 1) for i, spp in enumerate(budgets)}
    parts = {scene: plotted[plotted["scene"] == scene] for scene in panels}
    windows = {scene: _window(part, labels.direction) for scene, part in parts.items()}
    is_log = any(_spans_decades(*times) for _, times in windows.values())
    for scene, axes in panels.items():
        _set_scales(axes, windows[scene], is_log, labels.direction)
        style.note_hidden_points(axes, parts[scene], axes.get_ylim()[0])
        front = parts[scene][parts[scene]["front"]]
        if len(front):
            _shade_dominated(axes, front, labels.direction)
        ends = _draw_curves(axes, parts[scene], styles, sizes)
        if scene == scenes[0]:
            left = axes.get_xlim()[0]  # of a curve beyond it, the line to its name begins there
            inside = [(name, max(x, left), y) for name, x, y in ends]
            label_curves(axes, inside, styles, height, number)
        axes.set_title(scene, loc="left", fontweight="bold" if scene == OVERALL else "normal")
    better = f"  ({labels.direction} is better)" if labels.direction else ""
    panels[scenes[0]].set_ylabel(labels.score + better)
    has_uncertain = bool(plotted["uncertain"].any())
    _add_keys(figure, sizes, has_uncertain, (footer - 0.58) / (height + footer))
    figure.text(0.012, 0.014, caption, fontsize=10.5, color=style.BLACK, va="bottom")
    return figure


def _add_panels(
    figure: Figure, scenes: list[str], beside: float, bottom: float, top: float
) -> dict[str, Axes]:
    """The panels by scene; `beside` is the room in inches at the right of the first one."""
    rows = 1 if len(scenes) <= 2 else 2
    columns = math.ceil((len(scenes) - 1) / rows)
    others = (WIDTH - beside - GAP - 1.2) * columns / (columns + 1.5) if columns else -GAP
    end = WIDTH - others - GAP - beside - 0.15  # of the first panel, inches
    shared = {"top": top, "bottom": bottom}
    first = figure.add_gridspec(1, 1, left=0.068, right=end / WIDTH, **shared)
    panels = {scenes[0]: figure.add_subplot(first[0])}
    if columns:
        grid = figure.add_gridspec(
            rows, columns, left=1 - (others + 0.15) / WIDTH, right=0.988, wspace=0.17,
            hspace=0.3, **shared,
        )  # fmt: skip
        for i, scene in enumerate(scenes[1:]):
            panels[scene] = figure.add_subplot(grid[i // columns, i % columns])
    for i, axes in enumerate(panels.values()):
        if i == 0 or i + columns >= len(scenes):
            axes.set_xlabel("frame time [ms]")
    return panels


def _window(points: pd.DataFrame, direction: str) -> tuple[Range, Range]:
    """The scores and times that a panel shows; of PSNR, from WINDOW_DB below the best on.

    Intervals of uncertain times are inside.
    """
    low, high = points["value"].min(), points["value"].max()
    bottom = max(low, high - WINDOW_DB) if direction == "higher" else low
    inside = points[points["value"] >= bottom]
    times = inside.assign(
        **{
            f"frame_{end}_ms": inside[f"frame_{end}_ms"].where(
                inside["uncertain"], inside["frame_ms"]
            )
            for end in ENDS
        }
    )
    return (bottom, high), (times["frame_low_ms"].min(), times["frame_high_ms"].max())


def _spans_decades(left: float, right: float) -> bool:
    return left > 0 and right / left > LOG_RATIO


def _set_scales(axes: Axes, window: tuple[Range, Range], is_log: bool, direction: str) -> None:
    """Set limits and scales; a low score that spans decades is logarithmic too."""
    (low, high), (left, right) = window
    if is_log and left > 0:
        axes.set_xscale("log")
        is_short = right / left < FEW_TICKS
        rounded = MaxNLocator(FEW_TICKS - 1, steps=(1, 2, 5, 10))
        axes.xaxis.set_major_locator(
            rounded if is_short else LogLocator(subs=(1, 2, 5), numticks=20)
        )
        axes.xaxis.set_major_formatter(FuncFormatter(lambda ms, _: f"{ms:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(left / (right / left) ** 0.06, right * (right / left) ** 0.06)
    else:
        axes.set_xlim(left - 0.06 * (right - left or 1), right + 0.06 * (right - left or 1))
    if direction == "lower" and _spans_decades(low, high):
        axes.set_yscale("log")
        axes.set_ylim(low / 1.3, high * 1.3)
        return
    margin = 0.07 * (high - low or 1)
    axes.set_ylim(low - margin, high + margin)


def _shade_dominated(axes: Axes, front: pd.DataFrame, direction: str) -> None:
    """Shade the area that is slower and worse than a point of the Pareto front."""
    front = front.sort_values("frame_ms")
    times = [*front["frame_ms"], axes.get_xlim()[1]]
    values = [*front["value"], front["value"].iloc[-1]]
    worst = axes.get_ylim()[1 if direction == "lower" else 0]
    axes.fill_between(times, values, worst, step="post", color=DOMINATED_COLOUR, lw=0, zorder=0.5)


def _draw_curves(
    axes: Axes, points: pd.DataFrame, styles: dict[str, LineStyle], sizes: dict[float, float]
) -> list[tuple[str, float, float]]:
    """Draw the points of each method and a line through those whose times rise; returns ends."""
    ends = []
    for method, curve in points.groupby("method"):
        line, curve = styles[str(method)], curve.sort_values("target_spp")
        rise = curve.iloc[longest_rise(list(curve["frame_ms"]))]
        axes.plot(rise["frame_ms"], rise["value"], c=line.color, ls=line.dash, lw=1.8, zorder=2)
        for is_pale, part in curve.groupby("uncertain"):
            if is_pale:
                axes.hlines(
                    part["value"], part["frame_low_ms"], part["frame_high_ms"], color=line.color,
                    lw=1.2, alpha=PALE, zorder=1.5,
                )  # fmt: skip
            axes.scatter(
                part["frame_ms"], part["value"], s=part["target_spp"].map(sizes).tolist(),
                color=line.face, marker=line.marker, edgecolors=line.edge, zorder=3,
                linewidths=line.edge_width, alpha=PALE if is_pale else 1,
            )  # fmt: skip
        last = curve.iloc[-1]
        ends.append((str(method), float(last["frame_ms"]), float(last["value"])))
    return ends


def _add_keys(figure: Figure, sizes: dict[float, float], has_uncertain: bool, y: float) -> None:
    areas: list[Any] = [Patch(color=DOMINATED_COLOUR, label=DOMINATED)]
    areas += [_dot(64.0, UNCERTAIN, PALE, is_on_line=True)] * has_uncertain
    budgets = [_dot(size, f"{spp:g}") for spp, size in sizes.items()]
    shared: dict[str, Any] = {"frameon": False, "fontsize": 12, "borderaxespad": 0}
    figure.legend(
        handles=areas, loc="upper left", bbox_to_anchor=(0.012, y), columnspacing=1.4,
        ncol=len(areas), handletextpad=0.5, **shared,
    )  # fmt: skip
    budget_key = figure.legend(
        handles=budgets, loc="upper right", bbox_to_anchor=(0.99, y), columnspacing=0.8,
        ncol=len(budgets), handletextpad=0.1, title="samples per pixel", **shared,
    )  # fmt: skip
    budget_key.set_alignment("right")


def _dot(area: float, name: str, alpha: float = 1.0, is_on_line: bool = False) -> Line2D:
    return Line2D(
        [], [], linestyle="-" if is_on_line else "", marker="o", color=style.GREY, label=name,
        markersize=math.sqrt(area), markeredgecolor="white", alpha=alpha,
    )  # fmt: skip
