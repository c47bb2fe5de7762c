"""Experiments around the proposed method. Each is a command: python -m MODULE --help."""
