"""Tensors in nested values, such as a method's state: find, compare and replace them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from torch import Tensor

Leaf = Tensor | bool | int | float | str | None
T = TypeVar("T")


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


def read_leaves(value: Any, path: str = "state") -> Iterator[tuple[str, Leaf]]:
    """The tensors and numbers in a state of dataclasses, tuples, lists and dicts, by their path.

    Raises TypeError for any other object: the state cannot be written to a file then.
    """
    if value is None or isinstance(value, Tensor | bool | int | float | str):
        yield path, value
        return
    for name, part in _parts(value).items():
        yield from read_leaves(part, f"{path}.{name}")


def replace_leaves(value: Any, leaves: Mapping[str, Leaf], path: str = "state") -> Any:
    """A value of the structure of `value` with the leaves that `read_leaves` gave of another.

    Raises LookupError where that one has another structure.
    """
    if value is None or isinstance(value, Tensor | bool | int | float | str):
        return leaves[path]
    parts = {
        name: replace_leaves(part, leaves, f"{path}.{name}") for name, part in _parts(value).items()
    }
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **parts)
    if isinstance(value, dict):
        return dict(zip(value, parts.values(), strict=True))
    return value._make(parts.values()) if hasattr(value, "_make") else type(value)(parts.values())


def _parts(state: Any) -> dict[str, Any]:
    """The parts of one object of a state, by name or index."""
    if is_dataclass(state) and not isinstance(state, type):
        return {each.name: getattr(state, each.name) for each in fields(state) if each.init}
    if isinstance(state, dict):
        return {str(name): part for name, part in state.items()}
    if isinstance(state, tuple | list):
        return {str(index): part for index, part in enumerate(state)}
    raise TypeError(f"a state holds {type(state).__name__}, of which no part is known")


def map_tensors(function: Callable[[Tensor], Tensor], value: T) -> T:
    """A nested value with `function` applied to each of its tensors. Raises as `read_leaves`."""
    leaves = {
        path: function(leaf) if isinstance(leaf, Tensor) else leaf
        for path, leaf in read_leaves(value)
    }
    mapped: T = replace_leaves(value, leaves)
    return mapped
