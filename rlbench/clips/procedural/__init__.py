"""Clips that are computed when they are read."""
