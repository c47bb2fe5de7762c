"""Parts of the method names in the results: `ours/A2@seed3` has family ours and label seed3."""

from __future__ import annotations

from collections.abc import Set

from rlbench.benchmark.results import RowName

__all__ = ["family_of", "label_of", "only_label", "training_series_of", "without_label"]


def family_of(name: str) -> str:
    """The family: `ours` for `ours/A2@seed3`."""
    return RowName.parse(name).family


def label_of(name: str) -> str:
    """The label of weights or precision, `seed3` for `ours/A2@seed3`; empty without one."""
    return RowName.parse(name).label


def only_label(methods: Set[str]) -> str:
    """The label to compare by: the only one, if its families have no rows without a label.

    >>> only_label({"ours@brief", "ours/small@brief", "mean"}), only_label({"ours", "ours@seed1"})
    ('brief', '')
    """
    labelled = {method for method in methods if label_of(method)}
    labels, families = set(map(label_of, labelled)), set(map(family_of, labelled))
    if len(labels) == 1 and families.isdisjoint(map(family_of, methods - labelled)):
        return labels.pop()
    return ""


def without_label(name: str) -> str:
    """The family and variant: `ours/A2` for `ours/A2@seed3`."""
    return RowName.parse(name).method


def training_series_of(name: str) -> str:
    """The name that all trainings of one method share; empty for a name without a label.

    >>> training_series_of("ours/A2@seed12")
    'ours/A2@seed'
    """
    return name.rstrip("0123456789") if label_of(name) else ""
