"""Tensors in nested values, such as a method's state: find them and compare them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from torch import Tensor

__all__ = ["has_graph", "is_bit_equal", "iterate_tensors"]


def is_bit_equal(one: Tensor, other: Tensor) -> bool:
    """Do both have the same shape, type and values, NaN counting as equal to NaN?"""
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    return bool(((one == other) | ((one != one) & (other != other))).all())


def iterate_tensors(value: Any, visited: set[int] | None = None) -> Iterator[Tensor]:
    """Every tensor in a nested value, such as a state, in a fixed order."""
    visited = set() if visited is None else visited
    if isinstance(value, Tensor):
        yield value
    if id(value) in visited or isinstance(value, Tensor | str | bytes | type):
        return
    visited.add(id(value))
    parts: list[Any] = list(getattr(value, "__dict__", {}).values())
    if isinstance(value, Mapping):
        parts += value.values()
    elif isinstance(value, list | tuple):
        parts += value
    elif is_dataclass(value) and not hasattr(value, "__dict__"):  # with slots
        parts += [getattr(value, each.name) for each in fields(value)]
    for part in parts:
        yield from iterate_tensors(part, visited)


def has_graph(value: Any) -> bool:
    """Does any tensor in a nested value require gradients?"""
    return any(tensor.requires_grad for tensor in iterate_tensors(value))
