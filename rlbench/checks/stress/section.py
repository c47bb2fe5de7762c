"""A section of the stress suite, and the method that its tests run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch

from rlbench.checks.stress.result import StressResult
from rlbench.family import Traits
from rlbench.frames import Clip
from rlbench.method import Method
from rlbench.run import FrameResult, run_clip

__all__ = ["MethodSection", "StressedMethod", "SuiteSection"]

DEFAULT_SPP = 2.0  # samples per pixel of tests in which the budget does not matter


@dataclass(frozen=True)
class StressedMethod:
    """A method with the weights that it is scored with, its row name and its device."""

    name: str
    method: Method
    device: torch.device

    @property
    def traits(self) -> Traits:
        """The method's traits."""
        return self.method.traits

    @property
    def default_spp(self) -> float:
        """2 samples per pixel, or the nearest budget that the method supports."""
        low, high = self.traits.spp_range
        return min(max(low, DEFAULT_SPP), high)

    def run(self, clip: Clip, spp: float | None = None) -> list[FrameResult]:
        """The results of all frames of a clip, at `spp` samples per pixel (None: default_spp)."""
        return list(run_clip(self.method, clip, self.default_spp if spp is None else spp))


@dataclass(frozen=True)
class MethodSection:
    """Tests that run once per method."""

    name: str  # as in --only, e.g. "bad-pixel"
    title: str  # the question that the section answers
    run: Callable[[StressedMethod, bool], Iterator[StressResult]]  # the flag selects the quick form


@dataclass(frozen=True)
class SuiteSection:
    """Tests of the suite itself, which run once: metrics, gradient estimators."""

    name: str
    title: str
    run: Callable[[bool], Iterator[StressResult]]  # the flag selects the quick form
