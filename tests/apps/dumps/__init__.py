"""Tests of the app dumps."""
