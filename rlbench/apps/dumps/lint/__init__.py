"""Lint of clips: buffer conventions, independence of samples, and quality of the reference."""
