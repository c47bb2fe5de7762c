"""A baseline from results: scores of one seed, and the fall that a rerun may show.

A change of code that alters no quality may still alter the order of samples, or the rounding of
sums that decides between two pixels. Such a rerun is a draw like that of another seed, so seeds say
how far it may fall.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
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


def update_baseline(table: pd.DataFrame, path: Path, methods: Collection[str] = ()) -> Baseline:
    """Rewrite the baseline at `path` from the results of their smallest seed.

    Only the entries of `methods` are rewritten, or all if none are given. Cells that were measured
    with more seeds get a tolerance from them (`allowed_falls`); others keep theirs, as do the
    command, the speed gates and the tolerance between machines. Rewritten entries without a result
    are dropped. Cells that were skipped, such as budgets a method does not support, are left out.
    Raises BaselineError if a frame has no value, if a skipped cell has an entry in the old
    baseline, if entries that stay are of another preset or seed, and as `scores` does.
    """
    old = load_baseline(path) if path.exists() else Baseline()
    kept = [entry for entry in old.entries if methods and entry.method not in methods]
    if methods:
        table = table[table["method"].isin(methods)]
    tolerances = {e.key: e.tolerance_db for e in old.entries if e not in kept}
    found = seeds(table)
    seed = found[0] if found else old.seed
    if kept and (only_preset(table), seed) != (old.preset, old.seed):
        raise BaselineError(
            f"{path} is of preset {old.preset or 'none'} and seed {old.seed}, the results of "
            f"{only_preset(table) or 'none'} and {seed}. Measure those, or rewrite all methods"
        )
    measured = scores(table[table["frame"] != WHOLE_CLIP], seed)
    lost = {key for key, score in scores(table, seed).items() if score is None} & tolerances.keys()
    holes = sorted({key for key, score in measured.items() if score is None} | lost)
    if holes or not measured:
        named = ", ".join(map(str, holes)) or "anything"
        raise BaselineError(f"the results cannot be a baseline: no PSNR of {named}")
    cells = len(kept) + len(measured)
    tolerances |= allowed_falls(_scores_by_seed(table, found), old.tolerance_db, cells)
    entries = [
        BaselineEntry(*key, score.psnr, tolerances.get(key), score.stderr_db, score.frames)
        for key, score in measured.items()
        if score is not None
    ]
    entries = sorted([*kept, *entries], key=lambda entry: entry.key)
    new = replace(old, preset=only_preset(table), seed=seed, entries=tuple(entries))
    write_baseline(new, path)
    return new


def allowed_falls(
    by_seed: Mapping[ScoreKey, Sequence[float]], machine_db: float, cells: int
) -> dict[ScoreKey, float]:
    """The fall in dB that each cell with scores of two or more seeds is allowed.

    It is `machine_db`, plus the largest fall between two sample orders, exceeded in any of `cells`
    with probability 0.05: t s sqrt(2), with s the standard deviation between seeds and t the
    one-sided quantile of Student's distribution at 0.05 / cells (Bonferroni). A few seeds alone
    often give too small an s by chance, so its square is the average of the cell's own and of that
    of its method at the budget, over all scenes, whose degrees of freedom t has (a moderated t:
    Smyth 2004, Statistical Applications in Genetics and Molecular Biology 3, with equal weights).

    >>> cell = ScoreKey("mean", "city", 1.0)
    >>> allowed_falls({cell: [20.0, 20.02]}, machine_db=0.05, cells=1)[cell]
    0.1763
    """
    from scipy.stats import t as student

    repeated = {key: variance(psnrs) for key, psnrs in by_seed.items() if len(psnrs) > 1}
    groups: dict[tuple[str, float], list[ScoreKey]] = defaultdict(list)
    for key in repeated:
        groups[key.method, key.target_spp].append(key)
    falls = {}
    for keys in groups.values():
        weights = [len(by_seed[key]) - 1 for key in keys]
        quantile = float(student.isf(FALSE_ALARMS / cells, sum(weights)))
        pooled = fmean([repeated[key] for key in keys], weights)
        for key in keys:
            fall = quantile * math.sqrt(repeated[key] + pooled)  # s sqrt(2), s^2 their average
            falls[key] = round(machine_db + fall, DECIMALS)
    return falls


def _scores_by_seed(table: pd.DataFrame, found: Sequence[int]) -> dict[ScoreKey, list[float]]:
    """PSNR of each seed, in dB, of the cells that have a score."""
    by_seed: dict[ScoreKey, list[float]] = defaultdict(list)
    for seed in found:
        for key, score in scores(table, seed).items():
            if score:
                by_seed[key].append(score.psnr)
    return by_seed
