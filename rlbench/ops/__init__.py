"""Tensor operations the field agrees on."""
