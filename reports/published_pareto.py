"""The paper's two figures measured again: PSNR against budget and against frame time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.layout import style
from reports.layout.paired_panels import AXES, draw_pair
from reports.published import Published, no_published_rows, published

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_figures", "measured_points", "published_points", "write"]

METRIC = "psnr"
COLUMNS = ["method", "target_spp", "value", "frame_ms"]


def write(results: pd.DataFrame, folder: Path, name: str = "paper") -> list[Path]:
    """Write `name`-spp and `name`-time as PNG, PDF and SVG, and `name`-pareto.csv, per device.

    Frame time = gbuffer + plan + allocate + sampling + denoise, as in the results; that of the
    paper = inference + spp x 26.3 ms. Methods that the paper does not have are named in the caption
    only. Raises MissingRowsError if no method of the paper was measured.
    """
    devices = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        scores = Scores(rows, METRIC, device)
        if len(measured_points(scores)):
            devices.append(scores)
    if not devices:
        raise no_published_rows(results, METRIC)
    files = []
    for scores in devices:
        suffix = "" if len(devices) == 1 else f"-{style.slug(scores.device)}"
        for axis, figure in draw_figures(scores).items():
            with mpl.rc_context(style.RC):
                files += style.save_figure(figure, folder, f"{name}-{axis}{suffix}")
        file = folder / f"{name}-pareto{suffix}.csv"
        parts = {"here": measured_points(scores), "paper": published_points(published())}
        points = [part.assign(source=source) for source, part in parts.items()]
        pd.concat(points).to_csv(file, index=False)
        files.append(file)
    return files


def draw_figures(scores: Scores) -> dict[str, Figure]:
    """The figures of one device: `spp`, against samples per pixel, and `time`, against time."""
    measured, printed = measured_points(scores), published_points(published())
    missing = _missing_methods(scores, measured)
    with mpl.rc_context(style.RC):
        return {
            axis: draw_pair(measured, printed, AXES[axis], caption + missing)
            for axis, caption in _captions(scores, measured).items()
        }


def measured_points(scores: Scores) -> pd.DataFrame:
    """Measured means over scenes of the paper's methods; columns as in COLUMNS."""
    means = scores.overall
    means = means[means["method"].map(lambda method: published().find(method) is not None)]
    return pd.DataFrame(means[COLUMNS].reset_index(drop=True))


def published_points(paper: Published) -> pd.DataFrame:
    """Published scores, with frame times by the paper's mean cost; COLUMNS and `derived`."""
    records = []
    for point in paper.points():
        row = paper.find(point.row)
        inference_ms = row.inference_ms if row else float("nan")
        frame_ms = inference_ms + point.spp * paper.sample_ms
        records.append((point.row, point.spp, point.psnr_db, frame_ms, point.derived))
    return pd.DataFrame(records, columns=[*COLUMNS, "derived"])


def _captions(scores: Scores, measured: pd.DataFrame) -> dict[str, str]:
    paper = published()
    caption = (
        f"Left: PSNR, {scores.convention}; mean over scenes.\n"
        f"Right: {paper.title}, {paper.source}; {paper.conditions}; "
        "points joined by a dotted line: one of them is derived from the text.\n"
        "The panels have the same dB per inch but no common zero: compare the order of the "
        "methods, not their values."
    )
    budgets = ", ".join(f"{spp:g}" for spp in sorted(set(measured["target_spp"])))
    times = (
        f"\nPoints of a curve, from left to right: {budgets} spp, where measured. Measured frame "
        f"time: plan + allocate + denoise on {scores.device_name} + G-buffer + drawn samples per "
        f"pixel x time of one sample per pixel ({_short_cost_source(scores.cost_source)}); "
        f"published: inference + spp x {paper.sample_ms:g} ms."
    )
    return {"spp": caption, "time": caption + times}


def _short_cost_source(source: str) -> str:
    """The source of the cost in few words; of the paper's profile, the device and the scaling."""
    author = published().title.partition(",")[0]
    if author in source:
        return f"{source.partition(',')[0]}, published, {source.rpartition(', ')[2]}"
    return f"{source or 'not measured'}; rlbench run --cost paper-2080ti uses the published cost"


def _missing_methods(scores: Scores, measured: pd.DataFrame) -> str:
    """Caption lines with the methods that have scores and are not drawn."""
    absent = sorted(set(scores.measured["method"]) - set(measured["method"]))
    untimed = sorted(set(measured.loc[measured["frame_ms"].isna(), "method"]))
    doubted = set(scores.overall.loc[scores.overall["unreliable"], "method"])
    unreliable = sorted(doubted & set(measured["method"]))
    missing = {
        "Two devices": list(scores.device_mixes),
        "Unreliable times, measured on a busy machine": unreliable,
        "Measured, but not in the paper or not on every scene": absent,
        "Without a time": untimed,
    }
    return "".join(f"\n{title}: {', '.join(names)}." for title, names in missing.items() if names)
