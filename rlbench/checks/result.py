"""The result of a check: its verdict, what was found, and how to fix it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

__all__ = [
    "CheckResult",
    "Verdict",
    "failed",
    "not_applicable",
    "passed",
    "warning",
]


class Verdict(Enum):
    """Outcome of a check. Only FAILED makes a method or a clip unfit for a benchmark."""

    PASSED = "passed"
    WARNING = "warning"
    FAILED = "failed"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class CheckResult:
    """The outcome of one check of a method, a clip or this machine.

    >>> result = failed("albedo", "black everywhere", "export the albedo pass")
    >>> print(result)
    albedo: black everywhere -> export the albedo pass
    """

    check: str  # name of the check, as printed
    verdict: Verdict
    found: str = ""  # what was found, with the numbers that decide the verdict
    remedy: str = ""  # what to do about a warning or a failure
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
    return CheckResult(check, Verdict.FAILED, found, remedy, error)


def not_applicable(check: str, reason: str) -> CheckResult:
    """The check was skipped because it does not apply or cannot run here."""
    return CheckResult(check, Verdict.SKIPPED, reason)
