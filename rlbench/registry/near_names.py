"""What to say about a name that does not exist: the nearest one that does, and all if few do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

SHORT_LIST = 8  # names that are all listed beside the nearest one


def suggest(name: str, known: Iterable[str]) -> str:
    """A question that ends an error message, or an empty string if no known name is near.

    >>> suggest("uors", ["mean", "ours"])
    ". Did you mean 'ours'?"
    >>> suggest("reshade", ["mean", "ours"])
    ''
    """
    by_lower = {each.lower(): each for each in known}
    nearest = difflib.get_close_matches(name.lower(), list(by_lower), n=1)
    return f". Did you mean '{by_lower[nearest[0]]}'?" if nearest else ""


def unknown_name(
    problem: str, name: str, known: Iterable[str], introduction: str = "; available"
) -> str:
    """An error message: the problem, the known names, and the one nearest to `name`.

    A long list is left out where a name is near. `introduction` comes before the list.

    >>> unknown_name("no preset 'minni'", "minni", ["mini", "paper"])
    "no preset 'minni'; available: mini, paper. Did you mean 'mini'?"
    >>> unknown_name("no row 'r77'", "r77", [f"r{n}" for n in range(20)])
    "no row 'r77'. Did you mean 'r7'?"
    """
    names = list(known)
    nearest = suggest(name, names)
    listed = f"{introduction}: {', '.join(names) or 'none'}"
    return f"{problem}{'' if nearest and len(names) > SHORT_LIST else listed}{nearest}"
