"""Where plugins come from: entry points, a variable, and loose files; known before imported.

Three places are searched: entry points of installed packages (`rlbench.methods` and so on), the
variable RLBENCH_METHODS="name=module:FAMILY,...", and loose files given with `--plugin path.py`,
which hold `FAMILY` or a list `METHODS` of families. In a loose file `my_method.py`,
`build="my_method:build"` names its own function, whatever else is called `my_method`.

A name belongs to whom it was given first, and nothing is overwritten: the same name twice with
different targets is an error that says where both come from. A plugin that cannot be imported is
listed as broken, and raises its own error when it is asked for.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from rlbench.errors import PluginError

GROUPS = ("methods", "metrics", "reports", "pools", "scenes")
VARIABLE = "RLBENCH_METHODS"


@dataclass(frozen=True)
class PluginEntry:
    """One plugin that is known by name and not yet imported."""

    name: str
    target: str  # module:attribute, or the path of a loose file
    origin: str  # who brought it: a distribution and its version, the variable, or the file
    load: Callable[[], Any] = field(compare=False, repr=False)


_files: dict[str, Path] = {}  # loose files by their names without .py, in the order given


def use_plugin(path: str | Path) -> None:
    """Make the families of a loose file known; it is imported when methods are next asked for."""
    file = Path(path).resolve()
    if not file.is_file():
        raise PluginError(f"no plugin file at {file}; --plugin takes the path of a Python file")
    if _files.setdefault(file.stem, file) != file:
        raise PluginError(f"two plugin files are called {file.name}: {_files[file.stem]}, {file}")


def plugin_file_error(path: str | Path) -> str | None:
    """Why a loose file cannot be imported, and where, or None if it can."""
    file = Path(path).resolve()
    for entry in _from_file(file):
        try:
            entry.load()
        except PluginError as error:
            return str(error)
        except Exception as error:  # whatever a stranger's file may raise is what is told
            went = traceback.extract_tb(error.__traceback__)
            own = [frame for frame in went if frame.filename == str(file)]
            where = f" (line {own[-1].lineno})" if own else ""
            return f"{type(error).__name__}: {error}{where}"
    return None


def clear_plugins() -> None:
    """Undo every `use_plugin`."""
    _files.clear()


def entries(group: str) -> dict[str, PluginEntry]:
    """All plugins of a group by name, sorted. Raises PluginError if two share a name."""
    if group not in GROUPS:
        raise PluginError(f"'{group}' is not a kind of plugin; there are: {', '.join(GROUPS)}")
    found = installed(group)
    if group == "methods":
        found += _from_variable(os.environ.get(VARIABLE, ""))
        found += [entry for file in _files.values() for entry in _from_file(file)]
    known: dict[str, PluginEntry] = {}
    for entry in found:
        other = known.setdefault(entry.name, entry)
        if other.target != entry.target:
            raise PluginError(
                f"'{entry.name}' is given twice: by {other.origin} ({other.target}) and by "
                f"{entry.origin} ({entry.target}); rename or remove one"
            )
    return dict(sorted(known.items()))


def resolve(target: str) -> Any:
    """What `module:attribute` names, imported now."""
    module, _, attribute = target.partition(":")
    loose = _files.get(module)
    found: Any = _import_file(loose) if loose else importlib.import_module(module)
    for part in attribute.split("."):
        found = getattr(found, part)
    return found


def loose_files() -> tuple[Path, ...]:
    """The files given with `--plugin`, in the order given."""
    return tuple(_files.values())


def plugin_file(module: str) -> Path | None:
    """The file given with `--plugin` that goes by this module name, or None."""
    return _files.get(module)


def module_file(target: str) -> Path:
    """The file of the module that `module:attribute` names; the module is not imported.

    Raises PluginError where it cannot be found.
    """
    module = target.partition(":")[0]
    if module in _files:
        return _files[module]
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:  # of the package that would hold it
        spec = None
    if spec is None or not spec.origin:
        raise PluginError(f"'{target}' names no module that can be found")
    return Path(spec.origin)


def installed(group: str) -> list[PluginEntry]:
    """The plugins of installed packages alone, ours first."""
    found = importlib.metadata.entry_points(group=f"rlbench.{group}")
    ours_first = sorted(found, key=lambda point: (_origin(point) != "rlbench", point.name))
    return [PluginEntry(p.name, p.value, _origin(p), p.load) for p in ours_first]


def _origin(point: importlib.metadata.EntryPoint) -> str:
    return point.dist.name if point.dist else "an unnamed package"


def _from_variable(text: str) -> list[PluginEntry]:
    found = []
    for item in filter(None, (part.strip() for part in text.split(","))):
        name, equals, target = item.partition("=")
        if not (name and equals and ":" in target):
            raise PluginError(f"{VARIABLE} holds '{item}'; an item is name=module:FAMILY")
        found.append(PluginEntry(name, target, VARIABLE, partial(resolve, target)))
    return found


def _from_file(file: Path) -> list[PluginEntry]:
    origin = f"--plugin {file.name}"
    try:
        module = _import_file(file)
        families = getattr(module, "METHODS", None) or [getattr(module, "FAMILY", None)]
        if None in families:
            raise PluginError(f"{file.name} has neither FAMILY nor METHODS; see docs/plugins.md")
        if odd := [type(each).__name__ for each in families if not hasattr(each, "variants")]:
            raise PluginError(f"{file.name} holds a {odd[0]} where a Family is wanted")
    except Exception as error:  # listed as broken, raised again when asked for
        return [PluginEntry(file.stem, str(file), origin, partial(_raise, error))]
    return [PluginEntry(f.name, f"{file}:{f.name}", origin, partial(_itself, f)) for f in families]


def _import_file(file: Path) -> Any:
    name = f"rlbench_plugin_{sha256(str(file).encode()).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise PluginError(f"{file} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _raise(error: Exception) -> Any:
    raise error


def _itself(family: Any) -> Any:
    return family
