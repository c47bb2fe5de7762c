"""What each step adds, one rule or network at a time: from no memory to `ours/latent`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, mean_with_interval, pair
from reports.analysis.multiplicity import correct_by_holm, difference_columns, difference_notes
from reports.analysis.verdicts import VERDICT_NOTE
from reports.layout import style
from reports.layout.page import Section, describe_clips, write_page
from reports.layout.step_bars import draw_steps
from reports.layout.tables import Table, format_difference, pivot_by_budget
from rlbench.benchmark.results import MissingRowsError

__all__ = ["STEPS", "measure_steps", "write"]

STEPS = {  # row: what it has that the row before it lacks
    "oidn": "a U-Net with Intel's weights, no memory",
    "oidn/tuned": "its weights tuned on our clips",
    "accumulate": "memory by rule, reprojected samples",
    "accumulate/contrast": "density by rule, by the last contrast",
    "ours": "learned density, weights trained behind these rules",
    "ours/latent": "learned memory, larger networks",
}
MIN_ROWS = 3


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "waterfall",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv, .tex and a figure for each device: the rows of STEPS that were scored.

    Each step is the difference of a row to the one before it, paired by scene, clip and frame. The
    budgets are those that all rows have. Raises MissingRowsError with fewer than three rows.
    """
    devices, sections, files = split_by_device(results), [], []
    for device, rows in devices.items():
        check_comparable(rows)
        scores = Scores(rows, device=device)
        steps = measure_steps(scores, seed, draws)
        if steps.empty:
            continue
        lists = {"Differences": difference_notes(steps), "Rows": _describe_rows(steps)}
        sections.append(Section(device, [_table(scores, steps)], steps, lists))
        stem = name if len(devices) == 1 else f"{name}-{style.slug(device)}"
        caption = (
            f"PSNR, {scores.convention}, {describe_clips(scores.measured)}. A bar is the "
            "difference of a row to the one above it, paired by frame; whiskers: 95 % interval "
            "over scenes; pale: not resolved. The last line of a panel is the whole way."
        )
        with mpl.rc_context(style.RC):
            files += style.save_figure(draw_steps(steps, STEPS, caption), folder, stem)
    if not sections:
        raise MissingRowsError(
            f"fewer than {MIN_ROWS} of {', '.join(STEPS)} have scores at one budget; rlbench run "
            f"-m {','.join(STEPS)} --spp 1,4"
        )
    return [*write_page(folder, name, "What each step adds", results, sections), *files]


def measure_steps(scores: Scores, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES) -> pd.DataFrame:
    """A record for each step and budget, and one for the whole way, whose `step` is "all".

    Columns method, before, step, target_spp, value (PSNR of the row), and those of
    `difference_columns`. Empty where fewer than MIN_ROWS rows share a budget.
    """
    parts = {key: part for key, part in scores.per_frame.groupby(["method", "target_spp"])}
    means = scores.overall.set_index(["method", "target_spp"])["value"]
    rows, budgets = _choose_rows(means)
    records = []
    for spp in budgets:
        pairs = [*zip(rows[:-1], rows[1:], rows[1:], strict=True), (rows[0], rows[-1], "all")]
        for before, method, step in pairs:
            gap = mean_with_interval(pair(parts[method, spp], parts[before, spp]), seed, draws)
            keys = {"method": method, "before": before, "step": step, "target_spp": spp}
            records.append(
                keys
                | {"value": means[method, spp], "start": means[before, spp]}
                | difference_columns(gap)
            )
    return correct_by_holm(pd.DataFrame(records)) if records else pd.DataFrame()


def _choose_rows(means: pd.Series[float]) -> tuple[list[str], list[float]]:
    """The rows of STEPS with scores, and the budgets that all of them have; none if too few."""
    budgets = {row: {spp for method, spp in means.index if method == row} for row in STEPS}
    rows = [row for row, own in budgets.items() if own]
    shared = set.intersection(*(budgets[row] for row in rows)) if rows else set()
    return (rows, sorted(shared)) if len(rows) >= MIN_ROWS else ([], [])


def _table(scores: Scores, steps: pd.DataFrame) -> Table:
    named = steps.assign(
        method=[
            f"{row.method} - {row.before}"
            if row.step != "all"
            else f"all: {row.method} - {row.before}"
            for row in steps.itertuples()
        ]
    )
    order = list(dict.fromkeys(named["method"]))
    header, rows = pivot_by_budget(named, format_difference, order)
    caption = f"PSNR in dB ({scores.convention}), paired differences, mean over scenes."
    return Table("Steps", caption, ("step", *header[1:]), tuple(rows), VERDICT_NOTE)


def _describe_rows(steps: pd.DataFrame) -> Sequence[str]:
    used = {*steps["method"], *steps["before"]}
    return [f"{row}: {text}" for row, text in STEPS.items() if row in used]
