"""Tests of the app view."""
