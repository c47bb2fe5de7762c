"""The commands run, report and regress."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.errors import AskedError

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.benchmark.regression import Baseline


def part(
    table: pd.DataFrame, baseline: Baseline, methods: Collection[str]
) -> tuple[pd.DataFrame, Baseline]:
    """The rows and the entries of some methods. Raises AskedError for one that neither has."""
    have = {*table["method"], *(entry.method for entry in baseline.entries)}
    if unknown := sorted(set(methods) - have):
        raise AskedError(
            f"--only {','.join(unknown)}: neither results nor baseline have it; there is: "
            f"{', '.join(sorted(have)) or 'nothing'}"
        )
    entries = tuple(entry for entry in baseline.entries if entry.method in methods)
    return table[table["method"].isin(methods)], replace(baseline, entries=entries)


def rows(table: pd.DataFrame, methods: Collection[str], results: Path) -> pd.DataFrame:
    """The rows of methods, by any name that the table has or a pattern leads to.

    Raises AskedError where a single name has none, and PluginError for one that is in neither.
    """
    from rlbench.benchmark.results import AT, whose
    from rlbench.registry import lookup as registry

    known = set(table["method"])  # of plugins too, which need not be here
    exact = [name for name in methods if AT in name or name in known]
    patterns = [name for name in methods if name not in exact]
    wanted = exact + registry.expand(patterns, trained=False)  # what has rows had weights
    found = table[whose(table, wanted)]
    single = [n for n in methods if n.partition("/")[0] != "all" and not n.endswith("/*")]
    absent = [name for name in single if not whose(table, [name]).any()]
    if absent or found.empty:
        have = ", ".join(sorted(known)) or "no rows"
        raise AskedError(f"{results} has no rows of {', '.join(absent or methods)}; it has: {have}")
    return found
