"""Families, metrics, reports, pools and scenes: found, loaded and named."""
