"""The methods that a stress run can load: their shipped weights, or the reason why not."""

from __future__ import annotations

import torch

from rlbench import registry
from rlbench.checks.checked_returns import CheckedReturns
from rlbench.checks.stress.section import StressedMethod
from rlbench.system import provenance

__all__ = ["load_stressed_method", "unavailable_reason"]


def unavailable_reason(name: str) -> str | None:
    """Why a method cannot be stressed on this machine, or None.

    >>> unavailable_reason("mean") is None
    True
    """
    variant = registry.get_variant(name)
    if missing := " ".join(provenance.missing_packages(variant.requires)):
        return f"needs {missing}, which is not installed: pip install {missing}"
    if variant.learned and not registry.shipped_weights(name).is_file():
        return "has no shipped weights, and random ones say nothing about its stability"
    return None


def load_stressed_method(name: str, device: torch.device) -> StressedMethod:
    """The method with its shipped weights. Raises any exception of its `build` function."""
    return StressedMethod(name, CheckedReturns(registry.load_method(name, device)), device)
