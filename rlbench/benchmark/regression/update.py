"""A baseline from results: scores of one seed, and the fall that a rerun may show.

A change of code that alters no quality may still alter the order of samples, or the rounding of
sums that decides between two pixels. Such a rerun is a draw like that of another seed, so seeds say
how far it may fall.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean, variance
from typing import TYPE_CHECKING

from rlbench.benchmark.regression.baseline import (
    Baseline,
    BaselineEntry,
    BaselineError,
    ScoreKey,
    load_baseline,
    write_baseline,
)
from rlbench.benchmark.regression.scores import DECIMALS, only_preset, scores, seeds
from rlbench.benchmark.results import WHOLE_CLIP

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["FALSE_ALARMS", "allowed_falls", "update_baseline"]

FALSE_ALARMS = 0.05  # probability that a rerun in another sample order fails any entry


def update_baseline(table: pd.DataFrame, path: Path) -> Baseline:
    """Rewrite the baseline at `path` from the results of their smallest seed.

    Cells that were measured with more seeds get a tolerance from them (`allowed_falls`); others
    keep theirs, as do the command, the speed gates and the tolerance between machines. Entries
    without a result are dropped, so run the whole preset first. Cells that were skipped, such as
    budgets a method does not support, are left out. Raises BaselineError if a frame has no value,
    if a skipped cell has an entry in the old baseline, and as `scores` does.
    """
    old = load_baseline(path) if path.exists() else Baseline()
    tolerances = {entry.key: entry.tolerance_db for entry in old.entries}
    found = seeds(table)
    seed = found[0] if found else old.seed
    measured = scores(table[table["frame"] != WHOLE_CLIP], seed)
    lost = {key for key, score in scores(table, seed).items() if score is None} & tolerances.keys()
    holes = sorted({key for key, score in measured.items() if score is None} | lost)
    if holes or not measured:
        named = ", ".join(map(str, holes)) or "anything"
        raise BaselineError(f"the results cannot be a baseline: no PSNR of {named}")
    tolerances |= allowed_falls(_scores_by_seed(table, found), old.tolerance_db)
    entries = tuple(
        BaselineEntry(*key, score.psnr, tolerances.get(key), score.stderr_db, score.frames)
        for key, score in sorted(measured.items())
        if score is not None
    )
    new = replace(old, preset=only_preset(table), seed=seed, entries=entries)
    write_baseline(new, path)
    return new


def allowed_falls(
    by_seed: Mapping[ScoreKey, Sequence[float]], machine_db: float
) -> dict[ScoreKey, float]:
    """The fall in dB that each cell with scores of two or more seeds is allowed.

    It is `machine_db`, plus the largest fall between two draws of one sample order each, exceeded
    in any of the cells with probability 0.05: t s sqrt(2), with s the standard deviation between
    seeds and t the one-sided quantile of Student's distribution at 0.05 / cells (Bonferroni).
    s is the larger of the cell's own and that of its method, pooled over its cells, whose degrees
    of freedom t has: that of a few seeds alone is often too small by chance.

    >>> cell = ScoreKey("mean", "city", 1.0)
    >>> {str(key): round(fall, 3) for key, fall in allowed_falls({cell: [20.0, 20.02]}, 0.05).items()}
    {'mean on city at 1 spp': 0.176}
    """
    from scipy.stats import t as student

    repeated = {key: variance(psnrs) for key, psnrs in by_seed.items() if len(psnrs) > 1}
    cells: dict[str, list[ScoreKey]] = defaultdict(list)
    for key in repeated:
        cells[key.method].append(key)
    falls = {}
    for keys in cells.values():
        weights = [len(by_seed[key]) - 1 for key in keys]
        quantile = float(student.isf(FALSE_ALARMS / len(repeated), sum(weights)))
        pooled = fmean([repeated[key] for key in keys], weights)
        for key in keys:
            spread = math.sqrt(2 * max(repeated[key], pooled))
            falls[key] = round(machine_db + quantile * spread, DECIMALS)
    return falls


def _scores_by_seed(table: pd.DataFrame, found: Sequence[int]) -> dict[ScoreKey, list[float]]:
    """PSNR of each seed, in dB, of the cells that have a score."""
    by_seed: dict[ScoreKey, list[float]] = defaultdict(list)
    for seed in found:
        for key, score in scores(table, seed).items():
            if score:
                by_seed[key].append(score.psnr)
    return by_seed
