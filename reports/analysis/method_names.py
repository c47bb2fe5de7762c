"""Parts of the method names in the results: `ours/A2@seed3` has family ours and label seed3."""

from __future__ import annotations

from rlbench.benchmark.results import RowName

__all__ = ["family_of", "label_of", "training_series_of", "without_label"]


def family_of(name: str) -> str:
    """The family: `ours` for `ours/A2@seed3`."""
    return RowName.parse(name).family


def label_of(name: str) -> str:
    """The label of weights or precision, `seed3` for `ours/A2@seed3`; empty without one."""
    return RowName.parse(name).label


def without_label(name: str) -> str:
    """The family and variant: `ours/A2` for `ours/A2@seed3`."""
    return RowName.parse(name).method


def training_series_of(name: str) -> str:
    """The name that all trainings of one method share; empty for a name without a label.

    >>> training_series_of("ours/A2@seed12")
    'ours/A2@seed'
    """
    return name.rstrip("0123456789") if label_of(name) else ""
