"""A temple: stone, paint and furnishings."""
