"""Frames that others rendered, as clips: one module a format, and one that writes them down."""
