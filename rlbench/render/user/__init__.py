"""Rendering of the user's own scene files."""
