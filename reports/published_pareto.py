"""The paper's two figures anew, its points beside ours: PSNR against budget, and against time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import pandas as pd

from reports.analysis import aggregate
from reports.layout import paired_panels, style
from reports.published import Published, lacking, published

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRIC = "psnr"
COLUMNS = ["method", "target_spp", "value", "frame_ms"]


def write(table: pd.DataFrame, folder: Path, name: str = "paper") -> list[Path]:
    """`name`-spp and `name`-time as PNG, PDF and SVG, and `name`-pareto.csv; one set a device.

    Total time = plan + denoise + samples bought per pixel x time of one sample per pixel, as the
    table has it; the paper's = inference + spp x 26.3 ms. Rows that the paper does not have are
    named, not drawn. Raises LacksError if none of the paper's rows was measured.
    """
    parts = {}
    for device, rows in aggregate.by_device(table).items():
        aggregate.check(rows)
        if len(measured(rows)):
            parts[device] = rows
    if not parts:
        raise lacking(table, METRIC)
    written = []
    for device, rows in parts.items():
        suffix = "" if len(parts) == 1 else f"-{style.slug(device)}"
        for axis, figure in figures(rows, device).items():
            with mpl.rc_context(style.RC):
                written += style.save(figure, folder, f"{name}-{axis}{suffix}")
        file = folder / f"{name}-pareto{suffix}.csv"
        both = {"here": measured(rows), "paper": stated(published())}
        pd.concat([part.assign(source=of) for of, part in both.items()]).to_csv(file, index=False)
        written.append(file)
    return written


def figures(table: pd.DataFrame, device: str) -> dict[str, Figure]:
    """The figures of one device's rows: against samples per pixel, `spp`, and against `time`."""
    here, theirs = measured(table), stated(published())
    told = _others(table, here)
    with mpl.rc_context(style.RC):
        return {
            axis: paired_panels.draw(here, theirs, paired_panels.AXES[axis], caption + told)
            for axis, caption in _captions(table, here, device).items()
        }


def measured(table: pd.DataFrame) -> pd.DataFrame:
    """Columns method, spp, value, frame_ms of the paper's rows: means over scenes, as measured."""
    found = aggregate.overall(aggregate.points(table, METRIC))
    found = found[found["method"].map(lambda method: published().of(method) is not None)]
    return pd.DataFrame(found[COLUMNS].reset_index(drop=True))


def stated(paper: Published) -> pd.DataFrame:
    """The same columns, and `derived`, of what the paper states; times by its mean cost."""
    made = []
    for point in paper.points():
        row = paper.of(point.row)
        inference_ms = row.inference_ms if row else float("nan")
        frame_ms = inference_ms + point.spp * paper.sample_ms
        made.append((point.row, point.spp, point.psnr_db, frame_ms, point.derived))
    return pd.DataFrame(made, columns=[*COLUMNS, "derived"])


def _captions(table: pd.DataFrame, here: pd.DataFrame, device: str) -> dict[str, str]:
    paper = published()
    told = (
        f"Left: PSNR, {aggregate.column_text(table, METRIC, 'convention')}; mean over scenes.\n"
        f"Right: {paper.title}, Table 1; {paper.conditions}; "
        "dotted: from its text.\n"
        "The two panels share a scale, not a zero: their values cannot be compared, their orders "
        "can."
    )
    budgets = ", ".join(f"{spp:g}" for spp in sorted(set(here["target_spp"])))
    times = (
        f"\nPoints of a curve, from left to right: {budgets} spp, where it was run. Time here: "
        f"plan + denoise (p50) on {device or 'a device not named'} + samples bought per pixel x "
        f"time of one sample per pixel ({_cost(aggregate.profile(table))}); "
        "theirs: inference + spp x "
        f"{paper.sample_ms:g} ms."
    )
    return {"spp": told, "time": told + times}


def _cost(profile: str) -> str:
    """The source of the cost in few words; of the paper's, the device and the scaling."""
    author = published().title.partition(",")[0]
    if author in profile:
        return f"{profile.partition(',')[0]}, published, {profile.rpartition(', ')[2]}"
    return f"{profile or 'not measured'}; rlbench run --cost paper-2080ti charges the published one"


def _others(table: pd.DataFrame, here: pd.DataFrame) -> str:
    """The rows that are measured and not drawn, as lines of the caption."""
    scored = table[(table["metric"] == METRIC) & table["value"].notna()]
    left = sorted(set(scored["method"]) - set(here["method"]))
    untimed = sorted(set(here.loc[here["frame_ms"].isna(), "method"]))
    told = {"Measured, but not in the paper or not on every scene": left, "Without a time": untimed}
    return "".join(f"\n{what}: {', '.join(which)}." for what, which in told.items() if which)
