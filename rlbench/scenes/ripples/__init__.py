"""A bath with lilies and stones."""
