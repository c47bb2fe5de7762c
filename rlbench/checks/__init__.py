"""Checks of methods and of clips."""
