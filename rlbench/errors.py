"""Errors that several layers raise and the command line tells without a traceback."""

from __future__ import annotations


class PluginError(LookupError):
    """A name that no plugin has, two plugins of one name, or a plugin that breaks its promise."""


class AskedError(ValueError):
    """An option's value that cannot be used."""
