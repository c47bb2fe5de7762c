"""TOML and JSON documents as frozen dataclasses: decoded with types checked, written whole.

`msgspec` checks types and names the key that is wrong; `tomli_w` writes TOML.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import tomli_w

from rlbench.system.paths import replacing

__all__ = ["decode", "read_toml", "to_toml", "unknown_keys", "write_toml"]

T = TypeVar("T")


def decode(
    document: Mapping[str, Any], kind: type[T], *, renamed: Mapping[str, str] | None = None
) -> T:
    """A dataclass of type `kind` from a document's keys; keys that it does not have are ignored.

    `renamed` maps keys of older documents to today's. A list becomes a tuple and an int a float
    where the type asks for it. Raises ValueError, naming the key, for a value of another type and
    for a key that is missing.
    """
    today = {(renamed or {}).get(key, key): value for key, value in document.items()}
    return msgspec.convert(today, kind)


def unknown_keys(document: Mapping[str, Any], kind: type) -> list[str]:
    """Keys of a document that a dataclass does not have."""
    known = {each.name for each in dataclasses.fields(kind)}
    return sorted(document.keys() - known)


def read_toml(path: Path) -> dict[str, Any]:
    """The keys of a TOML file. Raises ValueError where it is not TOML in UTF-8."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not TOML: {error}") from error


def to_toml(document: Mapping[str, Any]) -> str:
    """A document as TOML, in the order of its keys; tuples become arrays."""
    return tomli_w.dumps(dict(document))


def write_toml(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document as a TOML file, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(to_toml(document), encoding="utf-8")
