"""PSNR of a submission, compared with other scores, or measured again here."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.regression.baseline import (
    Baseline,
    BaselineEntry,
    ScoreKey,
    find_baseline,
    load_baseline,
    scores,
    seeds,
    shipped_baselines,
)
from rlbench.benchmark.regression.comparison import BaselineDiff, compare
from rlbench.benchmark.results import COLUMNS
from rlbench.benchmark.submission.current import plan_of, uncheckable_methods
from rlbench.benchmark.submission.document import Submission, SubmittedCell
from rlbench.checks.result import CheckResult, failed, not_applicable, passed, warning

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["check_against_scores", "measure_again", "select_cells", "to_scores"]

BASELINE = "baseline"  # stands for the shipped one of the submission's preset


def to_scores(submission: Submission) -> pd.DataFrame:
    """PSNR of each frame, with the columns of a results table that comparisons read."""
    import pandas as pd

    scenes = {clip.name: clip.scene for clip in submission.clips}
    records = [
        {
            **{key: value for key, value in asdict(cell).items() if isinstance(value, str | int)},
            "target_spp": cell.target_spp,
            "scene": scenes.get(cell.clip, cell.clip),
            "preset": submission.preset,
            "frame": frame,
            "metric": "psnr",
            "value": value,
            "unit": "dB",
            "note": "",
        }
        for cell in submission.measured
        for frame, value in enumerate(cell.scores.get("psnr", ()))
    ]
    return pd.DataFrame(records, columns=None if records else list(COLUMNS))


def check_against_scores(submission: Submission, source: str) -> CheckResult:
    """Compare the cells that both have: results in the folder `source`, or a baseline.

    Raises RlbenchError for a source that cannot be read, or of another preset.
    """
    table = to_scores(submission)
    expected = _baseline_of(source, submission)
    common = compare(table, expected, subset=True)
    return _judge(f"scores against {source}", common.diffs)


def select_cells(submission: Submission, number: int, random: Random) -> list[SubmittedCell]:
    """`number` random cells of rows and clips that can be measured here, or all that there are."""
    unknown = set(uncheckable_methods({cell.method for cell in submission.cells}))
    cells = [cell for cell in submission.measured if cell.method not in unknown]
    return random.sample(cells, min(number, len(cells)))


def measure_again(
    submission: Submission,
    cells: Collection[SubmittedCell],
    clips: Mapping[str, StoredSource],
    folder: Path,
    on_cell: Callable[[], None] = lambda: None,
) -> list[CheckResult]:
    """Measure cells on this machine's clips, into `folder`, and compare each.

    A cell may be better than stated by any amount; it may be worse by no more than `rlbench
    regress` allows a rerun, or by what machines differ by where the baseline does not have it.
    """
    from rlbench.benchmark.results import read
    from rlbench.benchmark.runner import measure

    allowed = _allowed_falls(submission.preset)
    checks = []
    for cell in cells:
        name = f"measured again: {cell}"
        if cell.clip not in clips:
            checks.append(not_applicable(name, "the clip is not here; rlbench render makes it"))
            continue
        plan = plan_of(cell.method, [clips[cell.clip]], (cell.target_spp,), (cell.seed,))
        measure(plan, folder, scores_only=True)
        table = read(folder)
        rows = table[(table["method"] == cell.method) & (table["clip"] == cell.clip)]
        rows = rows[(rows["target_spp"] == cell.target_spp) & (rows["seed"] == cell.seed)]
        checks.append(_compare_cell(name, cell, rows, allowed))
        on_cell()
    return checks


def _compare_cell(
    name: str, cell: SubmittedCell, rows: pd.DataFrame, allowed: Mapping[ScoreKey, float]
) -> CheckResult:
    psnr = rows[(rows["metric"] == "psnr") & (rows["frame"] >= 0)]["value"]
    stated = [value for value in cell.scores.get("psnr", ()) if value is not None]
    if psnr.empty or not stated:
        reason = "; ".join(sorted(set(rows["note"]) - {""})) or "no score"
        return failed(name, reason, "run rlbench doctor; the cell gave no score here")
    scene, here, claim = rows["scene"].iloc[0], float(psnr.mean()), sum(stated) / len(stated)
    key = ScoreKey(cell.method, scene, cell.target_spp)
    limit = allowed.get(key, Baseline().tolerance_db)
    found = f"PSNR {here:.3f} dB here, {claim:.3f} dB stated, {here - claim:+.3f} dB"
    if here < claim - limit:
        remedy = "do not trust the cell: code, clip or number is another"
        return failed(name, f"{found}; a fall of {limit:.3f} dB is allowed", remedy)
    if here > claim + limit:
        return warning(name, found, "the file states less than it could; ask the author why")
    return passed(name, found)


def _baseline_of(source: str, submission: Submission) -> Baseline:
    """The scores to compare with, as a baseline."""
    from rlbench.benchmark.results import read

    if source == BASELINE:
        return load_baseline(find_baseline("", submission.preset))
    if source in shipped_baselines() or not Path(source).is_dir():
        return load_baseline(find_baseline(source))
    table = read(Path(source))
    rows = table[table["preset"] == submission.preset]
    found = seeds(rows)
    entries = [
        BaselineEntry(*key, score.psnr, stderr_db=score.stderr_db, frames=score.frames)
        for key, score in (scores(rows, found[0]) if found else {}).items()
        if score is not None
    ]
    return Baseline(preset=submission.preset, entries=tuple(entries), seed=found[0] if found else 0)


def _allowed_falls(preset: str) -> dict[ScoreKey, float]:
    """The falls that the shipped baseline allows; empty without one."""
    if preset not in shipped_baselines():
        return {}
    baseline = load_baseline(find_baseline(preset))
    return {
        entry.key: baseline.tolerance_db if entry.tolerance_db is None else entry.tolerance_db
        for entry in baseline.entries
    }


def _judge(check: str, diffs: Collection[BaselineDiff]) -> CheckResult:
    """Do the cells that both have agree, within the fall that each is allowed?"""
    both = [diff for diff in diffs if diff.change is not None]
    if not both:
        return not_applicable(check, "no cell is in both")
    wrong = [diff for diff in both if abs(diff.change or 0.0) > diff.tolerance_db]
    if wrong:
        worst = max(wrong, key=lambda diff: abs(diff.change or 0.0))
        text = (
            f"{len(wrong)} of {len(both)} cells differ by more than allowed, most {worst.key}: "
            f"{worst.measured:.3f} dB stated, {worst.expected:.3f} dB there"
        )
        return failed(check, text, "find out which of the two is wrong: rlbench verify --rerun 3")
    new = sum(diff.verdict == "new" for diff in diffs)
    return passed(check, f"{len(both)} cells agree, {new} are new")
