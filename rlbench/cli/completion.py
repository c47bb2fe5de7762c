"""Names that the shell completes; nothing heavy is imported."""

from __future__ import annotations

from collections.abc import Callable, Iterable

__all__ = ["complete_methods", "complete_names"]

Complete = Callable[[str], list[str]]


def complete_names(kind: str, more: Iterable[str] = ()) -> Complete:
    """A completer of the names of one kind, as in `rlbench list KIND`, and of `more` words.

    In a list a,b it completes the last name.
    """

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        names = [*_names(kind), *more]
        return [f"{before}{comma}{name}" for name in names if name.startswith(last)]

    return complete


def _names(kind: str) -> list[str]:
    from rlbench import registry
    from rlbench.benchmark.listing import list_installed

    if kind in ("scenes", "reports", "metrics"):
        return registry.list_plugins(kind)
    return [row["name"] for row in list_installed(kind)[kind]]


complete_methods = complete_names("methods", ("all",))
