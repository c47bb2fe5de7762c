"""Suggests the known name that is nearest to a misspelt one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = ["suggest"]


def suggest(name: str, known: Iterable[str]) -> str:
    """A question that ends an error message, or an empty string if no known name is near.

    >>> suggest("uors", ["mean", "ours"])
    ". Did you mean 'ours'?"
    >>> suggest("reshade", ["mean", "ours"])
    ''
    """
    nearest = difflib.get_close_matches(name.lower(), list(known), n=1)
    return f". Did you mean '{nearest[0]}'?" if nearest else ""
