"""Experiments behind the ledger (docs/development.md); run from a clone, not installed."""
