"""Experiments around the proposed method."""
