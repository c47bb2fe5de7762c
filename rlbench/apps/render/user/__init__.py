"""Rendering of a user's own scene files."""
