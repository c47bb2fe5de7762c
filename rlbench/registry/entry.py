"""A plugin that is known by name and not yet imported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

__all__ = ["PluginEntry"]


@dataclass(frozen=True)
class PluginEntry:
    """A plugin that is known by name and not yet imported."""

    name: str
    target: str  # module:attribute, or the path of a plugin file
    origin: str  # the distribution, the variable or the file that brings it
    load: Callable[[], Any] = field(compare=False, repr=False)
