"""Networks of other sizes than those of `ours/latent`, and what equal time buys with them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.curves import curves_of, measured_sample_ms
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, UNKNOWN, interval_of
from reports.analysis.method_names import only_label, without_label
from reports.analysis.multiplicity import correct_by_holm, difference_columns
from rlbench.benchmark.results import MissingRowsError

__all__ = ["BASE", "SIZES", "at_equal_latency", "nearest_budget", "select_sizes"]

BASE = "ours/latent"  # its networks have the sizes of the paper
SIZES = {  # row: how its networks differ from those of BASE; in the paper's order
    BASE: "base",
    "ours": "no encoder, memory by rule",
    "ours/latent-small": "all three small",
    "ours/latent-sampler-small": "1 to 2 channels, base: 4 to 32",
    "ours/latent-sampler-large": "64 to 1024 channels",
    "ours/latent-encoder-small": "kernels of 1x1, base: 3x3",
    "ours/latent-encoder-large": "two more layers",
    "ours/latent-denoiser-small": "OIDN's fast network",
    "ours/latent-denoiser-large": "twice the channels",
}
AT_MOST = 0.98  # a frame that takes a smaller share of the time could draw more samples


def select_sizes(results: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """The rows of SIZES, and their label: rows METHOD@LABEL count where there are no others.

    Raises MissingRowsError without scores of BASE and of another size.
    """
    label = only_label({name for name in results["method"] if without_label(name) in SIZES})
    if label:
        results = results.assign(method=results["method"].map(without_label))
    chosen = results[results["method"].isin(SIZES)]
    scored = set(chosen.loc[(chosen["metric"] == "psnr") & chosen["value"].notna(), "method"])
    if BASE not in scored or len(scored) < 2:
        raise MissingRowsError(
            f"{BASE} and another of {', '.join(list(SIZES)[1:])} are compared, and the results "
            f"have scores of {', '.join(sorted(scored)) or 'none of them'}; rlbench run -m "
            f"{BASE},ours,ours/latent-small. `make appendix` trains the others"
        )
    return chosen, label


def at_equal_latency(
    scores: Scores,
    rows: Sequence[str],
    base_name: str = BASE,
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> pd.DataFrame:
    """Each of `rows` in the frame time that the base, one of them, has at each of its budgets.

    Empty without times of the base. In the order of `rows`.

    Columns method, base_spp, deadline_ms, spp (the best budget in this time, between the measured
    ones; nan: none fits), share (of the base's samples), is_bound (more samples would fit than were
    measured), unreliable (a time of the row failed its test), value, and those of
    `difference_columns` (value minus the base's, paired by scene).
    """
    known = {curve.method: curve for curve in curves_of(scores)}
    curves = [known[row] for row in rows if row in known]
    sample_ms = measured_sample_ms(scores)
    doubted = set(scores.points.loc[scores.points["unreliable"], "method"])
    base = known.get(base_name)
    if base is None:
        return pd.DataFrame()
    records = []
    for base_spp in base.spp:
        own = np.array(base_spp)
        deadline = float(base.frame_ms_at(own, sample_ms))
        for curve in curves:
            limit = np.array(deadline)
            spp = base_spp if curve is base else float(curve.best_spp(np.array(sample_ms), limit))
            units = curve.units_at(np.array(spp))
            is_compared = curve is not base and not math.isnan(spp)
            gap = interval_of(units - base.units_at(own), seed, draws) if is_compared else UNKNOWN
            most = float(curve.frame_ms(np.array(sample_ms))[-1])
            records.append(
                {
                    "method": curve.method,
                    "base_spp": float(base_spp),
                    "deadline_ms": deadline,
                    "spp": spp,
                    "share": spp / base_spp,
                    "unreliable": curve.method in doubted,
                    "is_bound": curve is not base and most < AT_MOST * deadline,
                    "value": float(units.mean()),
                    **difference_columns(gap),
                }
            )
    return correct_by_holm(pd.DataFrame(records))


def nearest_budget(budgets: Iterable[float], spp: float) -> float:
    """The budget that is nearest to `spp` by its logarithm; of two, the smaller.

    >>> nearest_budget([0.5, 1.0, 2.0], 1.12)
    1.0
    """
    return min((b for b in budgets if b > 0), key=lambda b: (abs(math.log(b / spp)), b))
