"""Variants of a family against its default: which there are, what they change, what it gives."""

from __future__ import annotations

import json

import pandas as pd

from reports.analysis import aggregate, method_names
from reports.analysis.intervals import DRAWS, interval, paired
from rlbench.benchmark.results import MissingRowsError

FAVOURITE = "ours"  # whose variants are shown if none are asked for and it has some
METRIC = "psnr"
PAIR = ("scene", "clip", "frame", "seed")  # at one budget
COLUMNS = (
    "method", "target_spp", "difference", "low", "high", "frame_ms", "pairs", "alone", "units",
)  # fmt: skip


def families_with_scores(table: pd.DataFrame) -> dict[str, list[str]]:
    """Families with scores of their default, and which of their variants have scores as well."""
    methods = sorted({m for m in scored(table)["method"] if not method_names.weights(m)})
    return {
        default: [m for m in methods if method_names.family(m) == default and m != default]
        for default in methods
        if default == method_names.family(default)
    }


def scored(table: pd.DataFrame) -> pd.DataFrame:
    """The rows that are compared: scores that were measured."""
    return table[(table["metric"] == METRIC) & table["value"].notna()]


def chosen(table: pd.DataFrame, family: str = "") -> str:
    """The family whose variants are shown: the one asked for, or ours, or that of most variants.

    Raises LacksError if it has none here, or if there is no family with any.
    """
    parts = aggregate.by_device(table).values()
    variants = [found for rows in parts for found in families_with_scores(rows).items()]
    have = sorted({name for name, found in variants if found})
    if family and family not in have:
        raise MissingRowsError(
            f"'{family}' has no default and variant on one device; families that do: "
            f"{', '.join(have) or 'none'}; rlbench run --methods '{family}/*' measures them"
        )
    if not have:
        raise MissingRowsError(
            "no family has its default and a variant on one device; "
            f"rlbench run --methods '{FAVOURITE}/*' measures some"
        )
    most = max(variants, key=lambda pair: (len(pair[1]), pair[0]))[0]
    return family or (FAVOURITE if FAVOURITE in have else most)


def differences(
    table: pd.DataFrame, family: str, seed: int = 0, draws: int = DRAWS
) -> pd.DataFrame:
    """A row for each variant and budget: its PSNR and frame time less those of the default.

    Pairs have scene, clip, frame, budget and seed in common; `low` and `high` are the interval (nan
    with one clip). `frame_ms` is the difference of the means over the scenes that both have; nan
    where either has no time.
    """
    rows = scored(table)
    parts = {key: part for key, part in rows.groupby(["method", "target_spp"])}
    times = aggregate.points(table, METRIC)
    made = []
    for method in families_with_scores(table)[family]:
        for spp in sorted(set(rows["target_spp"])):
            if (method, spp) not in parts or (family, spp) not in parts:
                continue
            pairs = paired(parts[method, spp], parts[family, spp], PAIR)
            gap = interval(pairs, seed, draws)
            made.append(
                {
                    "method": method,
                    "target_spp": spp,
                    "difference": gap.mean,
                    "low": gap.low,
                    "high": gap.high,
                    "frame_ms": _slower(times[times["target_spp"] == spp], method, family),
                    "pairs": len(pairs),
                    "alone": len(parts[method, spp]) + len(parts[family, spp]) - 2 * len(pairs),
                    "units": gap.units,
                }
            )
    return pd.DataFrame(made, columns=list(COLUMNS))


def changes(table: pd.DataFrame, method: str, family: str) -> str:
    """Settings in which a variant differs from the default, as both wrote them into the table."""
    known = scored(table).drop_duplicates("method").set_index("method")["config"]
    theirs, base = json.loads(known[method]), json.loads(known[family])
    told = [
        f"{key}: {_told(base, key)} -> {_told(theirs, key)}"
        for key in sorted({*theirs, *base})
        if theirs.get(key) != base.get(key)
    ]
    return "; ".join(told) or "none that they wrote down"


def _told(config: dict[str, object], key: str) -> str:
    return json.dumps(config[key]) if key in config else "-"


def _slower(times: pd.DataFrame, method: str, other: str) -> float:
    """Frame time of one less that of the other, ms, mean over the scenes that both have."""
    one, two = (
        times[times["method"] == name].set_index("scene")["frame_ms"] for name in (method, other)
    )
    return float((one - two).mean())
