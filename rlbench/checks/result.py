"""The result of a check: its verdict, what was found, and how to fix it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum


class Verdict(Enum):
    """Outcome of a check. Only FAILED makes a method or a clip unfit for a benchmark."""

    PASSED = "passed"
    WARNING = "warning"
    FAILED = "failed"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Limits:
    """Thresholds of a figure: up to `good` it passes, up to `fair` it is degraded, beyond it fails.

    Where `fair` is below `good`, larger figures are better. A figure that is nan fails.

    >>> Limits(good=1.0, fair=3.0, unit="dB").verdict(2.0)
    <Verdict.WARNING: 'warning'>
    >>> Limits(good=30.0, fair=20.0, unit="dB").verdict(35.0)
    <Verdict.PASSED: 'passed'>
    """

    good: float = math.nan  # threshold of PASSED; nan where no threshold decides
    fair: float = math.nan  # threshold of WARNING
    unit: str = ""

    def verdict(self, figure: float) -> Verdict:
        """PASSED, WARNING (degraded) or FAILED."""
        sign = 1 if self.good <= self.fair else -1
        if math.isnan(figure) or sign * figure > sign * self.fair:
            return Verdict.FAILED
        return Verdict.PASSED if sign * figure <= sign * self.good else Verdict.WARNING

    def __str__(self) -> str:
        """`passes up to 1, fails above 3`."""
        if self.good == self.fair:
            return f"at most {self.good:g}"
        if math.isnan(self.fair):
            return f"limit {self.good:g}"
        words = ("up to", "above") if self.good < self.fair else ("from", "below")
        return f"passes {words[0]} {self.good:g}, fails {words[1]} {self.fair:g}"


@dataclass(frozen=True)
class CheckResult:
    """The outcome of one check of a method, a clip or this machine, or of a stress test.

    >>> result = failed("albedo", "black everywhere", "export the albedo pass")
    >>> print(result)
    albedo: black everywhere -> export the albedo pass
    """

    check: str  # name of the check or of the test, as printed
    verdict: Verdict
    found: str = ""  # what was found, with the numbers that decide the verdict
    remedy: str = ""  # what to do about a warning or a failure
    figure: float = math.nan  # of a stress test
    limits: Limits = Limits()  # of that figure
    error: Exception | None = field(default=None, compare=False, repr=False)  # raised by the method

    def __str__(self) -> str:
        """`check: found -> remedy`."""
        found = f": {self.found}" if self.found else ""
        remedy = f" -> {self.remedy}" if self.remedy else ""
        return self.check + found + remedy

    def raise_if_failed(self) -> None:
        """Raise AssertionError with this result's text if the check failed, for use in a test."""
        if self.verdict is Verdict.FAILED:
            raise AssertionError(str(self)) from self.error


def passed(check: str, found: str = "") -> CheckResult:
    """The check passed."""
    return CheckResult(check, Verdict.PASSED, found)


def warning(check: str, found: str, remedy: str) -> CheckResult:
    """The check found something unusual that may be intended, or could not decide."""
    return CheckResult(check, Verdict.WARNING, found, remedy)


def failed(check: str, found: str, remedy: str, error: Exception | None = None) -> CheckResult:
    """The check failed, with the exception that was raised, if any."""
    return CheckResult(check, Verdict.FAILED, found, remedy, error=error)


def not_applicable(check: str, reason: str) -> CheckResult:
    """The check was skipped because it does not apply or cannot run here."""
    return CheckResult(check, Verdict.SKIPPED, reason)


def judge(
    test: str, figure: float, limits: Limits, found: str = "", remedy: str = ""
) -> CheckResult:
    """The result whose verdict follows from a figure. `remedy` is dropped where it passed."""
    verdict = limits.verdict(figure)
    remedy = "" if verdict is Verdict.PASSED else remedy
    return CheckResult(test, verdict, found, remedy, figure, limits)
