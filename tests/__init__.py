"""Tests: each one a sentence."""
