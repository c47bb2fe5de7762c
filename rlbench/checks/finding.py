"""What one check of a clip says: a verdict, what was found, and what would do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """How a check ended. Only FAIL makes a clip unfit for a benchmark."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "FAIL"


@dataclass(frozen=True)
class Finding:
    """One convention that was looked at."""

    check: str  # its name, unique among the checks
    verdict: Verdict
    found: str  # in words, with the numbers on which the verdict rests
    remedy: str = ""  # what would do, where not all is well


def fine(check: str, found: str) -> Finding:
    """The check holds."""
    return Finding(check, Verdict.PASS, found)


def odd(check: str, found: str, remedy: str) -> Finding:
    """The check holds perhaps, or what was found may well be meant."""
    return Finding(check, Verdict.WARN, found, remedy)


def wrong(check: str, found: str, remedy: str) -> Finding:
    """The check does not hold."""
    return Finding(check, Verdict.FAIL, found, remedy)
