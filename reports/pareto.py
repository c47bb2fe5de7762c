"""The Pareto plot: score against frame time, a curve over budgets for each method."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import ReportError, check_comparable, split_by_device
from reports.layout import style
from reports.layout.page import describe_clips
from reports.layout.pareto_panels import MAX_PANELS, OVERALL, Labels, draw_pareto

__all__ = ["pareto_front", "plotted_points", "write"]


def write(
    results: pd.DataFrame, folder: Path, metric: str = "psnr", name: str = "pareto"
) -> list[Path]:
    """Write PNG, PDF and SVG of the plot and a CSV of its points, one set for each device.

    Frame time = gbuffer + plan + allocate + sampling + denoise. Points without a score or time are
    not plotted; those with an unreliable time are pale and never on the front. Raises ReportError
    if no point is left.
    """
    devices = split_by_device(results)
    files = []
    for device, rows in devices.items():
        check_comparable(rows)
        scores = Scores(rows, metric, device)
        points = plotted_points(scores)
        stem = name if len(devices) == 1 else f"{name}-{style.slug(device)}"
        with mpl.rc_context(style.RC):
            files += style.save_figure(draw_pareto(points, figure_labels(scores)), folder, stem)
        points.to_csv(folder / f"{stem}.csv", index=False)
        files.append(folder / f"{stem}.csv")
    return files


def plotted_points(scores: Scores) -> pd.DataFrame:
    """The rows of `scores.points` that have a frame time, and their means over scenes.

    `front` is true for the points on the Pareto front of their panel, which an unreliable time
    cannot be on. Raises ReportError if no point has a time, or if there are too many scenes for
    panels and no mean over them.
    """
    per_scene = scores.points
    mean = scores.overall.assign(scene=OVERALL)
    points = pd.concat([mean, per_scene], ignore_index=True)[per_scene.columns]
    points = points[points["frame_ms"].notna()].reset_index(drop=True)
    _check_points(points, scores)
    points["front"] = False
    for _, panel in points[~points["unreliable"]].groupby("scene"):
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
    title = metric.upper().replace("_", "-") if metric in ("psnr", "ms_ssim") else metric
    caption = (
        f"{title}: {scores.convention}; {describe_clips(scores.measured)}. "
        f"Frame time: plan + allocate + denoise on {scores.device_name}\n+ G-buffer + drawn "
        f"samples per pixel x time of one sample per pixel ({scores.cost_source or 'not named'})."
    )
    label = f"{title} [{unit}]" if unit else title
    heading = "; ".join(_describe_mix(scores, *mix) for mix in scores.device_mixes.items())
    return Labels(label, scores.direction, caption + _missing_methods(scores), heading)


def _describe_mix(scores: Scores, devices: str, methods: list[str]) -> str:
    """A line of the title: frame times of these methods add times of two devices."""
    everyone = set(scores.measured["method"]) <= set(methods)
    named = "" if everyone else f" ({', '.join(methods)})"
    return f"Two devices: {devices}{named}"


def _check_points(points: pd.DataFrame, scores: Scores) -> None:
    if points.empty:
        rows = scores.rows
        measured = sorted(set(rows.loc[rows["value"].notna(), "metric"])) or ["nothing"]
        raise ReportError(
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
    unreliable = set(points.loc[points["unreliable"], "method"])
    missing = {
        "Not on every scene and frame": partial,
        "Without a time on every scene": untimed,
        "Pale: an unreliable time, measured on a busy machine": unreliable,
    }
    return "".join(
        f"\n{title}: {', '.join(sorted(methods))}." for title, methods in missing.items() if methods
    )
