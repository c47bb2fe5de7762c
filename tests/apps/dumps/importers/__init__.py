"""Frames that others rendered, written by code of its own from closed forms, and read back."""
