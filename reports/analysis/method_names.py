"""What a row's name says: `ours/A2@seed3` is family ours, its variant A2, the weights seed3."""

from __future__ import annotations


def row(method: str) -> str:
    """The name without its weights: family or family/variant."""
    return method.partition("@")[0]


def family(method: str) -> str:
    """The name's family."""
    return row(method).partition("/")[0]


def weights(method: str) -> str:
    """The name of the weights that it ran with; empty for the shipped ones."""
    return method.partition("@")[2]


def training_series(method: str) -> str:
    """Several trainings alike have one: `ours@seed` of `ours@seed0`; empty for shipped weights."""
    return method.rstrip("0123456789") if weights(method) else ""
