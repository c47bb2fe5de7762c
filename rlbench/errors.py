"""Errors that several layers raise and the command line tells without a traceback."""

from __future__ import annotations

OURS = ("rlbench", "baselines", "methods", "metrics", "reports")


class PluginError(LookupError):
    """A name that no plugin has, two plugins of one name, or a plugin that breaks its promise."""


class OptionError(ValueError):
    """An option's value that cannot be used."""


def _expected(error: Exception) -> bool:
    """Is it of our own types, so that its message says all there is to say?"""
    return type(error).__module__.partition(".")[0] in OURS
