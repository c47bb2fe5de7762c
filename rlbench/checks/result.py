"""The result of a check: its verdict, what was found, and how to fix it."""

from __future__ import annotations

import traceback
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

__all__ = [
    "CheckResult",
    "Verdict",
    "describe_exception",
    "failed",
    "not_applicable",
    "passed",
    "warning",
]


PACKAGE = Path(__file__).parents[1]


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


def describe_exception(error: BaseException, *folders: Path) -> str:
    """The exception, the last line of code in `folders` that it passed through, and its notes.

    A line in the first folder is preferred to one in the second, and so on; without any, it is the
    last line outside this package.
    """
    frames = traceback.extract_tb(error.__traceback__)[::-1]
    own = [f for folder in folders for f in frames if Path(f.filename).is_relative_to(folder)]
    own += [f for f in frames if not Path(f.filename).is_relative_to(PACKAGE)]
    place = f" ({Path(own[0].filename).name}, line {own[0].lineno})" if own else ""
    notes = "".join(f", {note}" for note in getattr(error, "__notes__", ()))
    return f"raised {type(error).__name__}: {error}{place}{notes}"
