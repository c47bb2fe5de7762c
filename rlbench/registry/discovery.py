"""Finds plugins by name, without importing them.

Plugins come from two places: entry points of installed packages (`rlbench.methods` and so on), and
plugin files given with `--plugin path.py`, which define `FAMILY` or a list `METHODS` of families,
and `METRIC` or a list `METRICS`. In a plugin file `my_method.py`, `build="my_method:build"` names
its own function, even if an installed module is also called `my_method`.

No plugin overwrites another: one name with two targets is an error that states both origins. A
plugin that cannot be imported is listed, and raises its own error when it is loaded.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

from rlbench.errors import PluginError
from rlbench.registry.failure import describe_failure
from rlbench.registry.plugin_code import exits_as_errors
from rlbench.registry.plugin_files import (
    PluginEntry,
    file_entries,
    import_file,
    metric_entries,
    plugin_file,
    plugin_files,
    python_file,
)

GROUPS = (
    "methods", "metrics", "reports", "image_reports", "pools", "scenes", "stress", "apps",
)  # fmt: skip
_logger = logging.getLogger(__name__)


def plugin_file_error(path: str | Path) -> str | None:
    """The error and its line if a plugin file cannot be imported, else None."""
    file = python_file(path)
    for entry in file_entries(file):
        try:
            entry.load()
        except PluginError as error:
            return str(error)
        except Exception as error:  # third-party code may raise anything
            return describe_failure(error, file.parent)
    return None


def list_entries(group: str) -> dict[str, PluginEntry]:
    """All plugins of a group by name, sorted. Raises PluginError if two share a name."""
    if group not in GROUPS:
        raise PluginError(f"'{group}' is not a kind of plugin; there are: {', '.join(GROUPS)}")
    candidates = installed_entries(group)
    if group == "methods":
        candidates += [entry for file in plugin_files() for entry in file_entries(file)]
    if group == "metrics":
        candidates += [entry for file in plugin_files() for entry in metric_entries(file)]
    by_name: dict[str, PluginEntry] = {}
    for entry in candidates:
        first = by_name.setdefault(entry.name, entry)
        if first.target != entry.target:
            raise PluginError(
                f"two plugins are called '{entry.name}': {first.target} from {first.origin}, and "
                f"{entry.target} from {entry.origin}. Rename or remove one"
            )
    return dict(sorted(by_name.items()))


def resolve(target: str) -> Any:
    """Import the object that `module:attribute` names.

    >>> resolve("rlbench.family:Family").__name__
    'Family'
    """
    module, _, attribute = target.partition(":")
    file = plugin_file(module)
    with exits_as_errors(), _naming_what_shadows(module):
        value: Any = import_file(file) if file else importlib.import_module(module)
    for part in attribute.split("."):
        value = getattr(value, part)
    return value


def module_file(target: str) -> Path:
    """The file of the module in `module:attribute`; the module itself is not imported.

    Raises PluginError if there is no such module.
    """
    module = target.partition(":")[0]
    if file := plugin_file(module):
        return file
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:  # raised for a missing parent package
        spec = None
    if spec is None or not spec.origin:
        reason = _shadowing_reason(module) or "Check that it is installed"
        raise PluginError(f"no module '{module}', named by '{target}'. {reason}")
    return Path(spec.origin)


def installed_entries(group: str) -> list[PluginEntry]:
    """The plugins of installed packages, those of rlbench first."""
    return list(_read_entries(group, tuple(sys.path)))


@lru_cache(maxsize=64)
def _read_entries(group: str, path: tuple[str, ...]) -> list[PluginEntry]:
    """The same, read once for each sys.path: reading metadata takes tens of milliseconds."""
    points = _read_entry_points(path).select(group=f"rlbench.{group}")
    entries = [PluginEntry(p.name, p.value, _origin(p), partial(_load, p)) for p in points]
    return sorted(entries, key=lambda entry: (entry.origin != "rlbench", entry.name))


@lru_cache(maxsize=8)
def _read_entry_points(path: tuple[str, ...]) -> Any:
    return importlib.metadata.entry_points()  # its type differs between Python 3.11 and 3.12


def _load(point: importlib.metadata.EntryPoint) -> Any:
    _logger.debug("%s of %s: %s", point.name, point.group, point.value)
    with exits_as_errors(), _naming_what_shadows(point.module):
        return point.load()


@contextmanager
def _naming_what_shadows(module: str) -> Iterator[None]:
    """Raise PluginError where the package of `module` is hidden by a file of the same name."""
    try:
        yield
    except ImportError as error:
        if reason := _shadowing_reason(module):
            raise PluginError(reason) from error
        raise


def _origin(point: importlib.metadata.EntryPoint) -> str:
    return point.dist.name if point.dist else "an unnamed package"


def _shadowing_reason(module: str) -> str:
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
