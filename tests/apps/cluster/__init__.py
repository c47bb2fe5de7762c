"""Tests of the app cluster."""
