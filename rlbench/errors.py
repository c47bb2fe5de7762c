"""The base of every error that rlbench raises for what a user can cause, and shared subclasses."""

from __future__ import annotations


class RlbenchError(Exception):
    """Something a user can mend. The command line prints its message without a traceback."""


class PluginError(RlbenchError, LookupError):
    """An unknown plugin name, two plugins of one name, or a plugin that breaks the contract."""


class OptionError(RlbenchError, ValueError):
    """A command-line option whose value cannot be used."""
