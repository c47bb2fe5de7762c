"""The methods of a first run: `make demo`, and `rlbench run` without --methods."""

from __future__ import annotations

from rlbench.registry.discovery import list_entries
from rlbench.registry.plugin_files import file_entries, plugin_files

__all__ = ["demo_methods"]


def demo_methods() -> list[str]:
    """Names in the entry points `rlbench.demo`, then the families of plugin files.

    >>> "ours" in demo_methods()
    True
    """
    own = [entry.name for file in plugin_files() for entry in file_entries(file)]
    return list(dict.fromkeys([*list_entries("demo"), *own]))
