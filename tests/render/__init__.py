"""Tests of the path tracer."""
