"""Tensors in nested values, such as a method's state: find them and compare them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from torch import Tensor


def is_bit_equal(one: Tensor, other: Tensor) -> bool:
    """True if both have the same shape, type and values, NaN counting as equal to NaN."""
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    return bool(((one == other) | ((one != one) & (other != other))).all())


def iterate_parts(value: Any, visited: set[int] | None = None) -> Iterator[Any]:
    """A nested value, such as a state, and all of its parts, each object once, in a fixed order."""
    visited = set() if visited is None else visited
    if id(value) in visited or isinstance(value, type):
        return
    visited.add(id(value))
    yield value
    if isinstance(value, Tensor | str | bytes):
        return
    parts: list[Any] = list(getattr(value, "__dict__", {}).values())
    if isinstance(value, Mapping):
        parts += [*value.keys(), *value.values()]
    elif isinstance(value, list | tuple | set | frozenset):
        parts += value
    elif is_dataclass(value) and not hasattr(value, "__dict__"):  # with slots
        parts += [getattr(value, field.name) for field in fields(value)]
    for part in parts:
        yield from iterate_parts(part, visited)


def iterate_tensors(value: Any) -> Iterator[Tensor]:
    """Every tensor in a nested value, each once, in a fixed order."""
    return (part for part in iterate_parts(value) if isinstance(part, Tensor))


def has_graph(value: Any) -> bool:
    """True if any tensor in a nested value requires gradients."""
    return any(tensor.requires_grad for tensor in iterate_tensors(value))
