"""The limits of the fields of clip.toml: a table of ranges, and of names that are safe in paths."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

__all__ = ["LIMITS", "MAX_PIXELS", "Limits", "describe_value", "find_violation", "is_plain_name"]

MAX_PIXELS = 2**26  # of an image: 8192 x 8192
MAX_NAME_BYTES = 200  # of a name in UTF-8, so that it fits into a file name
MAX_TEXT = 10_000  # characters of any other text
NAMES = ("name", "scene")  # may have parts, as in street/mini
TEXTS = ("preset", "sampler", "sampler_version", "licence", "device", "timed_with")


class Limits(NamedTuple):
    """The range of a number, ends included; for a list, the range of each of its numbers."""

    lowest: float
    highest: float
    allows_nan: bool = False  # nan: unknown

    def allow(self, value: float) -> bool:
        """Whether a value is in the range."""
        return self.lowest <= value <= self.highest or (self.allows_nan and math.isnan(value))

    def __str__(self) -> str:
        """The range for a message."""
        suffix = ", or nan for unknown" if self.allows_nan else ""
        return f"{self.lowest:.10g} to {self.highest:.10g}{suffix}"


LIMITS = {
    "height": Limits(1, 2**16),  # pixels
    "width": Limits(1, 2**16),  # pixels
    "frames": Limits(1, 100_000),
    "fps": Limits(1e-6, 1e6),
    "seed": Limits(0, 2**63 - 1),
    "exposure": Limits(1e-12, 1e12),
    "pool_spp": Limits(1, 1024),
    "radiance_cap": Limits(1e-12, math.inf),
    "reference_spp": Limits(0, 2**31 - 1),
    "noise_ceiling_db": Limits(-1000, 1000),
    "sample_ms": Limits(0, 1e12, allows_nan=True),
    "pools_ms": Limits(0, 1e12, allows_nan=True),
    "sample_p5_ms": Limits(0, 1e12),
    "sample_p95_ms": Limits(0, 1e12),
    "gbuffer_ms": Limits(0, 1e12),
}


def find_violation(fields: Any) -> str | None:
    """The first field outside its limits, what it is and what it must be; None if there is none."""
    for key, limits in LIMITS.items():
        value = getattr(fields, key)
        for number in value if isinstance(value, tuple) else (value,):
            if not limits.allow(number):
                listed = "lists" if isinstance(value, tuple) else "is"
                return f"{key} {listed} {describe_value(number)}, expected {limits}"
    if (pixels := fields.height * fields.width) > MAX_PIXELS:
        return f"height x width is {pixels} pixels, expected at most {MAX_PIXELS}"
    return _find_unsafe_text(fields)


def _find_unsafe_text(fields: Any) -> str | None:
    parts = [(key, part) for key in NAMES for part in getattr(fields, key).split("/")]
    for key, name in [*parts, *(("pools", pool) for pool in fields.pools)]:
        if not is_plain_name(name) or (key == "pools" and " " in name):
            return (
                f"{key} has {describe_value(name)}, expected letters, digits and . _ + - @ alone, "
                f"in at most {MAX_NAME_BYTES} bytes"
            )
    for key in (*NAMES, *TEXTS):
        most = MAX_NAME_BYTES if key in NAMES else MAX_TEXT
        if (length := len(getattr(fields, key).encode(errors="replace"))) > most:
            return f"{key} has {length} bytes, expected at most {most}"
    return _find_duplicate("buffers", fields.buffers) or _find_duplicate("pools", fields.pools)


def is_plain_name(name: str) -> bool:
    """Whether a name is safe as a file name: no folder, no control character, not only dots.

    >>> is_plain_name("hall-cut"), is_plain_name("../hall"), is_plain_name("..")
    (True, False, False)
    """
    is_short = len(name.encode(errors="replace")) <= MAX_NAME_BYTES
    return is_short and bool(re.fullmatch(r"[\w .+@-]+", name) and name.strip(". "))


def describe_value(value: Any) -> str:
    """A value for a message, shortened to 80 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python converts no integer of more than 4300 digits
        return "an integer of more than 4300 digits"
    return text if len(text) <= 80 else f"{text[:77]}..."


def _find_duplicate(key: str, words: Sequence[str]) -> str | None:
    twice = sorted({word for word in words if words.count(word) > 1})
    return f"{key} lists {', '.join(twice)} twice" if twice else None
