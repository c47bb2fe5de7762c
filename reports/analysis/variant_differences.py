"""Variants of a family compared with the row that they change: scores, times and config."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, UNKNOWN, mean_with_interval, pair
from reports.analysis.method_names import family_of, label_of
from reports.analysis.multiplicity import correct_by_holm, difference_columns
from rlbench.benchmark.results import MissingRowsError

__all__ = [
    "choose_family",
    "config_changes",
    "differences",
    "families_with_scores",
    "group_by_base",
]

PREFERRED = "ours"  # the family of the report if the user names none
PAIR = ("scene", "clip", "frame", "seed")  # what the two scores of a pair have in common
COLUMNS = (
    "method", "base", "target_spp", *difference_columns(UNKNOWN), "frame_ms", "unreliable", "pairs",
    "unpaired", "units",
)  # fmt: skip


def families_with_scores(scores: Scores) -> dict[str, list[str]]:
    """Families whose main variant has scores, each with its other variants that have scores."""
    methods = sorted({name for name in scores.measured["method"] if not label_of(name)})
    return {
        main: [name for name in methods if family_of(name) == main and name != main]
        for main in methods
        if main == family_of(main)
    }


def choose_family(devices: Sequence[Scores], family: str = "") -> str:
    """`family`, else ours, else the family with the most variants.

    Raises MissingRowsError if no device has scores of its main variant and another, or if no family
    has them.
    """
    variants = [item for scores in devices for item in families_with_scores(scores).items()]
    complete = sorted({name for name, others in variants if others})
    if family and family not in complete:
        raise MissingRowsError(
            f"no device has scores of the main variant of '{family}' and of another variant; "
            f"families with both: {', '.join(complete) or 'none'}; measure them with "
            f"rlbench run --methods '{family}/*'"
        )
    if not complete:
        raise MissingRowsError(
            "no family has scores of its main variant and of another variant on one device; "
            f"measure some with rlbench run --methods '{PREFERRED}/*'"
        )
    largest = max(variants, key=lambda item: (len(item[1]), item[0]))[0]
    return family or (PREFERRED if PREFERRED in complete else largest)


def group_by_base(methods: Sequence[str]) -> dict[str, list[str]]:
    """Rows of a family, in groups by the row that they are compared with.

    The base of `family/part-change` is `family/part` if that is among `methods`, else `family`.

    >>> group_by_base(["ours", "ours/A1", "ours/paper", "ours/paper-A1", "ours/latent-A1"])
    {'ours': ['ours/A1', 'ours/latent-A1', 'ours/paper'], 'ours/paper': ['ours/paper-A1']}
    """
    groups: dict[str, list[str]] = {}
    for method in sorted(methods):
        family = family_of(method)
        part = method.rpartition("-")[0]
        while part and part not in methods:
            part = part.rpartition("-")[0]
        if method != family:
            groups.setdefault(part or family, []).append(method)
    return groups


def differences(
    scores: Scores,
    base: str,
    methods: Sequence[str],
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> pd.DataFrame:
    """Score and frame time of each of `methods` minus those of `base`, per budget.

    The two scores of a pair have scene, clip, frame, budget and seed in common; `low` and `high`
    are the interval (nan with one clip); `p_holm` is corrected over all differences. `frame_ms` is
    the mean difference over the scenes that both have; nan where either has no time. `unreliable`
    is true if a time of either failed its test.
    """
    parts = {key: part for key, part in scores.measured.groupby(["method", "target_spp"])}
    records = []
    for method in methods:
        for spp in sorted(set(scores.measured["target_spp"])):
            if (method, spp) not in parts or (base, spp) not in parts:
                continue
            variant, main = parts[method, spp], parts[base, spp]
            pairs = pair(variant, main, PAIR)
            gap = mean_with_interval(pairs, seed, draws)
            times = scores.points[scores.points["target_spp"] == spp]
            records.append(
                {
                    "method": method,
                    "base": base,
                    "target_spp": spp,
                    **difference_columns(gap),
                    "frame_ms": _frame_time_difference(times, method, base),
                    "unreliable": bool(
                        times.loc[times["method"].isin([method, base]), "unreliable"].any()
                    ),
                    "pairs": len(pairs),
                    "unpaired": len(variant) + len(main) - 2 * len(pairs),
                    "units": gap.units,
                }
            )
    return correct_by_holm(pd.DataFrame(records, columns=list(COLUMNS)))


def config_changes(scores: Scores, method: str, other: str) -> str:
    """The settings in which the config of `method` differs from that of `other`: `a: 1 -> 2`."""
    configs = scores.measured.drop_duplicates("method").set_index("method")["config"]
    changed, base = json.loads(configs[method]), json.loads(configs[other])
    changes = [
        f"{key}: {_value(base, key)} -> {_value(changed, key)}"
        for key in sorted({*changed, *base})
        if changed.get(key) != base.get(key)
    ]
    return "; ".join(changes) or "no setting in the results"


def _value(config: dict[str, Any], key: str) -> str:
    return json.dumps(config[key]) if key in config else "-"


def _frame_time_difference(times: pd.DataFrame, method: str, other: str) -> float:
    """Mean difference of the frame time over the scenes that both have, ms."""
    first, second = (
        times[times["method"] == name].set_index("scene")["frame_ms"] for name in (method, other)
    )
    return float((first - second).mean())
