"""The base of all errors that a user can cause, and the errors that several layers raise."""

from __future__ import annotations

__all__ = ["OptionError", "PluginError", "RlbenchError"]


class RlbenchError(Exception):
    """An error that the user can fix. The command line prints its message without a traceback."""


class PluginError(RlbenchError, LookupError):
    """An unknown plugin, two plugins with the same name, or a plugin that violates its contract."""


class OptionError(RlbenchError, ValueError):
    """A command-line option with an unusable value."""
