"""Checks: conformance of methods, and lint of clips."""
