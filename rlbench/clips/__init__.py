"""Clips: their files, header, digest and decode cache."""
