"""The result of a stress test: a figure, two thresholds, and the verdict that follows from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rlbench.checks.result import Verdict

__all__ = ["Limits", "StressResult", "judge", "skip"]


@dataclass(frozen=True)
class Limits:
    """Thresholds of a figure: up to `good` it passes, up to `fair` it is degraded, beyond it fails.

    Where `fair` is below `good`, larger figures are better. A figure that is nan fails.

    >>> Limits(good=1.0, fair=3.0, unit="dB").verdict(2.0)
    <Verdict.WARNING: 'warning'>
    >>> Limits(good=30.0, fair=20.0, unit="dB").verdict(35.0)
    <Verdict.PASSED: 'passed'>
    """

    good: float
    fair: float
    unit: str = ""

    def verdict(self, figure: float) -> Verdict:
        """PASSED, WARNING (degraded) or FAILED."""
        sign = 1 if self.good <= self.fair else -1
        if math.isnan(figure) or sign * figure > sign * self.fair:
            return Verdict.FAILED
        return Verdict.PASSED if sign * figure <= sign * self.good else Verdict.WARNING


@dataclass(frozen=True)
class StressResult:
    """What one test found for one method, or for the suite itself (method "")."""

    method: str  # name of the row, or "" where the test concerns the suite
    section: str  # name of the section, e.g. "bad-pixel"
    test: str  # name of the test, unique in its section, e.g. "sample-nan"
    verdict: Verdict
    figure: float = math.nan
    unit: str = ""
    good: float = math.nan  # threshold of PASSED
    fair: float = math.nan  # threshold of WARNING
    found: str = ""  # what was found, with the figures that decide, for a reader
    remedy: str = ""  # what to change in the method, empty if it passed or `found` says it


def judge(
    method: str,
    section: str,
    test: str,
    figure: float,
    limits: Limits,
    found: str = "",
    remedy: str = "",
) -> StressResult:
    """The result of a test whose verdict follows from a figure and its limits.

    `remedy` is dropped where the test passed.
    """
    verdict = limits.verdict(figure)
    remedy = "" if verdict is Verdict.PASSED else remedy
    return StressResult(
        method, section, test, verdict, figure, limits.unit, limits.good, limits.fair, found, remedy
    )


def skip(method: str, section: str, test: str, reason: str) -> StressResult:
    """The result of a test that does not apply to the method."""
    return StressResult(method, section, test, Verdict.SKIPPED, found=reason)
