"""What a claim says of a method: that it holds, that it fails, or that it cannot be asked."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum


class Verdict(Enum):
    """How a claim ended. Only FAILS makes a method unfit for a benchmark."""

    HOLDS = "hold"
    FAILS = "fail"
    MOOT = "do not apply"


@dataclass(frozen=True)
class Finding:
    """One claim that was tried."""

    verdict: Verdict
    found: str = ""  # in words, with the numbers on which the verdict rests
    error: Exception | None = field(default=None, compare=False, repr=False)  # what it raised


def wrong(found: str, error: Exception | None = None) -> Finding:
    """The claim fails."""
    return Finding(Verdict.FAILS, found, error)


def moot(why: str) -> Finding:
    """The claim is not one about this method, or nothing can be told here."""
    return Finding(Verdict.MOOT, why)
