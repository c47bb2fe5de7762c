"""Parts of a row's name: `ours/A2@seed3` is family ours, its variant A2, the weights seed3."""

from __future__ import annotations

from rlbench.benchmark.results import RowName


def row(method: str) -> str:
    """The name without its label: family or family/variant."""
    return RowName.parse(method).method


def family(method: str) -> str:
    """The name's family."""
    return RowName.parse(method).family


def weights(method: str) -> str:
    """The label of the weights; empty for the shipped ones."""
    return RowName.parse(method).label


def training_series(method: str) -> str:
    """The name that several trainings of one method share: `ours@seed` of `ours@seed0`.

    Empty for shipped weights.
    """
    return method.rstrip("0123456789") if weights(method) else ""
