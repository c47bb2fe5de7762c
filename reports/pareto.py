"""The Pareto plot: error against the whole time of a frame, a curve a method, over budgets."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd

from reports.analysis import aggregate
from reports.layout import page, style
from reports.layout.pareto_panels import MOST, OVERALL, draw


def write(
    table: pd.DataFrame, folder: Path, metric: str = "psnr", name: str = "pareto"
) -> list[Path]:
    """PNG, PDF and SVG of the plot, and a CSV of what is plotted; one set for each device.

    Total time = plan + denoise + samples bought per pixel x time of one sample per pixel. Cells
    without score or time are not plotted. Raises ReportError if nothing can be.
    """
    parts = aggregate.by_device(table)
    written = []
    for device, rows in parts.items():
        aggregate.check(rows)
        plotted = curves(rows, metric)
        file = name if len(parts) == 1 else f"{name}-{style.slug(device)}"
        with mpl.rc_context(style.RC):
            figure = draw(plotted, _texts(rows, metric, device))
            written += style.save(figure, folder, file)
        plotted.to_csv(folder / f"{file}.csv", index=False)
        written.append(folder / f"{file}.csv")
    return written


def curves(table: pd.DataFrame, metric: str = "psnr") -> pd.DataFrame:
    """What is plotted: rows of `scores.points` with a total time, and their means over scenes.

    `front` is true for a point of its panel that none is both faster and better than.
    """
    per_scene = aggregate.points(table, metric)
    mean = aggregate.overall(per_scene).assign(scene=OVERALL)
    every = pd.concat([mean, per_scene], ignore_index=True)[per_scene.columns]
    every = every[every["frame_ms"].notna()].reset_index(drop=True)
    if every.empty:
        found = sorted(set(table.loc[table["value"].notna(), "metric"])) or ["nothing"]
        raise aggregate.ReportError(
            f"no cell has {metric}, plan_ms, denoise_ms and sample_ms, so no time can be plotted; "
            f"measured were: {', '.join(found)}; rlbench run --cost takes a published sample_ms"
        )
    if OVERALL not in set(every["scene"]) and every["scene"].nunique() > MOST:
        raise aggregate.ReportError(
            f"no method has {metric} and times at one budget on each of {every['scene'].nunique()} "
            f"scenes, and more than {MOST} have no panels of their own; plot fewer scenes"
        )
    every["front"] = False
    better = aggregate.column_text(table, metric, "direction")
    for _, panel in every.groupby("scene"):
        kept = aggregate.pareto_front(panel["frame_ms"], panel["value"], better)
        every.loc[panel.index[kept], "front"] = True
    return every


def _texts(table: pd.DataFrame, metric: str, device: str) -> dict[str, str]:
    unit, better = (
        aggregate.column_text(table, metric, "unit"),
        aggregate.column_text(table, metric, "direction"),
    )
    title = metric.upper().replace("_", "-") if metric in ("psnr", "ms_ssim") else metric
    value = f"{title} [{unit}]" if unit else title
    direction = {"higher": "  (up is better)", "lower": "  (down is better)"}.get(better, "")
    counted = table[(table["metric"] == metric) & table["value"].notna()]
    caption = (
        f"{title}: {aggregate.column_text(table, metric, 'convention')}; {page.clips(counted)}. "
        f"Time: plan + denoise (p50) on {device or 'a device not named'}\n+ samples bought per "
        f"pixel x time of one sample per pixel ({aggregate.profile(table) or 'source not named'})."
    )
    caption += _missing(table, metric)
    return {"value": value, "direction": direction, "better": better, "caption": caption}


def _missing(table: pd.DataFrame, metric: str) -> str:
    """What has no mean over scenes though it was measured, as lines of the caption."""
    per_scene = aggregate.points(table, metric)
    untimed = set(per_scene.loc[per_scene["frame_ms"].isna(), "method"])
    scored = table.loc[(table["metric"] == metric) & table["value"].notna()]
    whole = aggregate.overall(per_scene).groupby("method")["target_spp"].nunique()
    asked = scored.groupby("method")["target_spp"].nunique()
    partly = {method for method, budgets in asked.items() if whole.get(method, 0) < budgets}
    told = {"Not on every scene and frame": partly, "Without a time on every scene": untimed}
    return "".join(f"\n{what}: {', '.join(sorted(who))}." for what, who in told.items() if who)
