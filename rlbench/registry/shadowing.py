"""Finds what hides a package: a user's `metrics.py` beside a script is imported before ours."""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

__all__ = ["shadowing_reason"]


def shadowing_reason(module: str) -> str:
    """Why a module cannot be imported, if a file hides its top-level package; else empty.

    `module` is a dotted name, such as `metrics.catalog`, and is not imported.
    """
    package = module.partition(".")[0]
    origins = [origin for spec in _candidates(package) for origin in _origins(spec)]
    if "." not in module or len(set(origins)) < 2:
        return ""
    submodule = module.split(".")[1]
    if any((origins[0] / f"{submodule}{suffix}").exists() for suffix in ("", ".py")):
        return ""
    hidden_by = _file(origins[0])
    return (
        f"`{package}` is shadowed by {hidden_by}: run from another folder, or rename that "
        f"{'file' if hidden_by.is_file() else 'folder'}"
    )


def _candidates(package: str) -> list[ModuleSpec]:
    """All packages of this name that Python can find, the one that it imports first."""
    found = [PathFinder.find_spec(package, [entry]) for entry in sys.path]
    for finder in sys.meta_path:  # those of editable installs
        if finder is not PathFinder:
            found.append(finder.find_spec(package, None))
    return [spec for spec in found if spec is not None]


def _origins(spec: ModuleSpec) -> list[Path]:
    """The folders of a package, or the file of a module without its suffix."""
    if spec.submodule_search_locations is not None:
        return [Path(folder).resolve() for folder in spec.submodule_search_locations]
    return [Path(spec.origin).resolve()] if spec.origin else []


def _file(origin: Path) -> Path:
    """The file of a module or package, or its folder where that has no `__init__.py`."""
    return origin / "__init__.py" if (origin / "__init__.py").is_file() else origin
