"""TOML and JSON documents as typed dataclasses: reading with type checks, and writing.

`msgspec` checks the types and names the key that is wrong; `tomli_w` writes TOML.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import tomli_w

from rlbench.system.paths import atomic_write

T = TypeVar("T")


def decode(document: Mapping[str, Any], kind: type[T]) -> T:
    """Decode a document into a dataclass of type `kind`; keys without a field are ignored.

    A list becomes a tuple, and an int a float, where the field has that type.

    >>> from rlbench.system.provenance import Machine
    >>> decode({"cpu": "EPYC", "cores": 4, "gpu": "", "os": "Linux"}, Machine).cores
    4

    Raises ValueError, naming the key, for a value of another type, a missing key, and a value that
    the dataclass itself refuses with a ValueError.
    """
    return msgspec.convert(document, kind)


def unknown_keys(document: Mapping[str, Any], kind: type) -> list[str]:
    """The keys of a document for which the dataclass `kind` has no field, sorted."""
    fields = {field.name for field in dataclasses.fields(kind)}
    return sorted(document.keys() - fields)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises ValueError for a file that is not TOML in UTF-8.

    A byte-order mark, which editors of Windows write, is skipped.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:  # no TOML, not UTF-8, or nested too deeply
        raise ValueError(f"{path} is not TOML: {error}") from error


def read_json(path: Path) -> Any:
    """Read a JSON file. Raises ValueError for a file that is not JSON in UTF-8.

    NaN, infinite values and numbers beyond the range of float64 are not JSON.
    """
    try:
        return msgspec.json.decode(path.read_bytes())
    except (ValueError, RecursionError) as error:  # no JSON, not UTF-8, or nested too deeply
        raise ValueError(f"{path} is not JSON: {error}") from error


def to_toml(document: Mapping[str, Any]) -> str:
    """Format a document as TOML, keys in order; tuples become arrays."""
    return tomli_w.dumps(dict(document))


def write_toml(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document to a TOML file atomically."""
    with atomic_write(path) as temporary:
        temporary.write_text(to_toml(document), encoding="utf-8")
