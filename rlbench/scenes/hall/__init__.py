"""A hall with machines and lamps."""
