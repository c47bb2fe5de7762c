"""Families in the place of those that cannot be imported, so that a run gives them rows."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager

from rlbench.errors import PluginError
from rlbench.family import Family, Traits, Variant

_families: dict[str, Family] = {}
_reasons: dict[str, str] = {}


@contextmanager
def stand_ins(reasons: Mapping[str, str], variants: Collection[str]) -> Iterator[None]:
    """Within it, families have stand-ins that can be looked up, and that fail where they are built.

    `reasons` says by name of a family why it cannot be imported. A stand-in has the variant "" and
    those of its family in `variants`, given as `family/variant`.
    """
    for key in reasons:
        names = {"", *(name.partition("/")[2] for name in variants if name.startswith(f"{key}/"))}
        declared = {name: Variant("", Traits(), learned=False) for name in names - {"*"}}
        _families[key] = Family(key, "", "", "", declared, build=f"{key}:build")
    _reasons.update(reasons)
    try:
        yield
    finally:
        for key in reasons:
            del _families[key], _reasons[key]


def find_stand_in(family: str) -> Family | None:
    """The stand-in of a family, or None."""
    return _families.get(family)


def import_failure(method: str) -> PluginError | None:
    """Why the family of a method has a stand-in, or None if it has none."""
    family = method.partition("/")[0]
    return PluginError(_reasons[family]) if family in _reasons else None
