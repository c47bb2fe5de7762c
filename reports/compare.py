"""Two methods compared: the answer as data and text.

The command `rlbench compare` prints it.
"""

from __future__ import annotations

import pandas as pd

from reports.analysis import notes
from reports.analysis.aggregate import Scores
from reports.analysis.comparability import ReportError, check_comparable, select_device
from reports.analysis.comparison import Comparison, compare_at_budgets
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.layout.comparison_text import comparison_text

__all__ = ["compare", "comparison_text"]


def compare(
    results: pd.DataFrame,
    first: str,
    second: str,
    metric: str = "psnr",
    device: str = "",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> Comparison:
    """Compare two methods of the results at every budget that both have.

    Scores are paired by scene, clip, frame and seed of the sample order. `device` names the device
    where the results have several; `seed` and `draws` are those of the bootstrap. Raises
    ReportError if a method, a metric or a pair is missing, or if rows cannot be compared.
    """
    results = results[results["method"].isin([first, second])]
    if results["method"].nunique() < 2:
        found = ", ".join(sorted(set(results["method"]))) or "neither"
        raise ReportError(
            f"a comparison of {first} and {second} was requested, and the results have {found}; "
            "name two different rows, or measure them with rlbench run"
        )
    rows, device = select_device(results, device)
    check_comparable(rows)
    scores = Scores(rows, metric, device)
    if scores.direction not in ("higher", "lower"):
        ranked = rows[rows["value"].notna() & (rows["direction"] != "") & (rows["unit"] != "ms")]
        raise ReportError(
            f"metric '{metric}' was requested, and the results have no values of it that rank "
            f"methods; metrics that do: {', '.join(sorted(set(ranked['metric']))) or 'none'}"
        )
    budgets = compare_at_budgets(scores, first, second, seed, draws)
    if not budgets:
        raise ReportError(
            f"{first} and {second} have no score of {metric} on the same frame at the same budget; "
            f"measure both: rlbench run -m {first},{second}"
        )
    paired = scores.measured[scores.measured["target_spp"].isin([b.target_spp for b in budgets])]
    both = paired[paired["method"] == first].merge(
        paired[paired["method"] == second], on=["scene", "clip", "frame", "seed", "target_spp"]
    )
    return Comparison(
        first=first,
        second=second,
        metric=metric,
        unit=scores.column_text("unit"),
        convention=scores.convention,
        direction=scores.direction,
        device=device,
        scenes=tuple(sorted(set(both["scene"]))),
        clips=both["clip"].nunique(),
        seeds=tuple(sorted(set(both["seed"]))),
        budgets=budgets,
        notes=tuple(notes.remarks(scores.measured)),
    )
