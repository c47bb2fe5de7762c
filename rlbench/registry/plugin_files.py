"""Plugin files: Python files and packages given with `--plugin`, with methods and metrics."""

from __future__ import annotations

import ast
import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from rlbench.errors import PluginError
from rlbench.registry.failure import describe_failure
from rlbench.registry.plugin_code import exits_as_errors

INIT = "__init__.py"
_files: dict[str, Path] = {}  # plugin files by the name of their module, in the order given


@dataclass(frozen=True)
class PluginEntry:
    """A plugin that is known by name and not yet imported."""

    name: str
    target: str  # module:attribute, or the path of a plugin file
    origin: str  # the distribution or the file that brings it
    load: Callable[[], Any] = field(compare=False, repr=False)


def use_plugin(path: str | Path) -> None:
    """Add the methods and metrics of a plugin file, which is imported when they are looked up.

    The folder of a package stands for its `__init__.py`. Raises PluginError for a missing file, one
    that does not parse, and for two files of one name.
    """
    file = python_file(path)
    if not file.is_file():
        inner = file.parent / file.parent.name / INIT
        hint = f". Did you mean {inner.parent}?" if file.name == INIT and inner.is_file() else ""
        raise PluginError(
            f"no plugin file at {file}. A plugin is a Python file, or the folder of a package{hint}"
        )
    _check_syntax(file)
    name = _module_name(file)
    if _files.setdefault(name, file) != file:
        raise PluginError(
            f"two plugin files are called {_label(file)}: {_files[name]} and {file}. Rename one"
        )


def _check_syntax(file: Path) -> None:
    try:
        ast.parse(file.read_bytes(), file)
    except (OSError, ValueError, SyntaxError) as error:  # ValueError: null bytes
        raise PluginError(
            f"plugin {file} is no Python code: {describe_failure(error, file.parent)}"
        ) from error


def python_file(path: str | Path) -> Path:
    """The file that a value of `--plugin` names: itself, or the `__init__.py` of a folder."""
    file = Path(path).resolve()
    return file / INIT if file.is_dir() else file


def _module_name(file: Path) -> str:
    return _label(file).removesuffix(".py")


def clear_plugins() -> None:
    """Undo every `use_plugin`."""
    _files.clear()


def _label(file: Path) -> str:
    """The name of a file, or of the folder of a package."""
    return file.parent.name if file.name == INIT else file.name


def plugin_files() -> tuple[Path, ...]:
    """The files given with `--plugin`, in the order given."""
    return tuple(_files.values())


def plugin_file(module: str) -> Path | None:
    """The file given with `--plugin` that has this module name, or None."""
    return _files.get(module)


def file_entries(file: Path) -> list[PluginEntry]:
    """The families that a file defines, or one entry that raises the error of the file."""
    name = _module_name(file)
    origin = f"--plugin {_label(file)}"
    try:
        module = import_file(file)
        families = getattr(module, "METHODS", None) or [getattr(module, "FAMILY", None)]
        if None in families and _metrics_of(module):
            return []
        if None in families:
            raise PluginError(
                f"{file.name} has none of FAMILY, METHODS, METRIC and METRICS; see "
                "docs/how-to/add-a-method.md and add-a-metric.md"
            )
        if others := [type(item).__name__ for item in families if not hasattr(item, "variants")]:
            raise PluginError(
                f"{file.name} defines an object of type {others[0]} as a method; a Family is "
                "expected, see docs/how-to/add-a-method.md"
            )
    except Exception as error:  # the plugin is listed, and raises this error when it is loaded
        return [PluginEntry(name, str(file), origin, partial(_raise, error))]
    return [PluginEntry(f.name, f"{file}:{f.name}", origin, partial(_same, f)) for f in families]


def metric_entries(file: Path) -> list[PluginEntry]:
    """The metrics that a file defines; none if it cannot be imported, as `file_entries` says."""
    module_name, origin = _module_name(file), f"--plugin {_label(file)}"
    try:
        metrics = _metrics_of(import_file(file))
    except Exception:  # third-party code may raise anything
        return []
    if others := [type(item).__name__ for item in metrics if not hasattr(item, "score")]:
        raise PluginError(
            f"{file.name} defines an object of type {others[0]} as a metric; a Metric is "
            "expected, see docs/how-to/add-a-metric.md"
        )
    return [
        PluginEntry(m.name, f"{module_name}:{m.name}", origin, partial(_same, m)) for m in metrics
    ]


def _metrics_of(module: Any) -> list[Any]:
    own = getattr(module, "METRIC", None)
    return [*(getattr(module, "METRICS", None) or ()), *([own] if own is not None else ())]


def plugin_file_methods() -> list[str]:
    """Names of the families that the files given with `--plugin` define."""
    return [entry.name for file in plugin_files() for entry in file_entries(file)]


def import_file(file: Path) -> Any:
    """Import a file once, under a name that no installed module has."""
    name = f"rlbench_plugin_{sha256(str(file).encode()).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    folders = [str(file.parent)] if file.name == INIT else None  # of a package's other modules
    spec = importlib.util.spec_from_file_location(name, file, submodule_search_locations=folders)
    if spec is None or spec.loader is None:
        raise PluginError(f"{file} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with exits_as_errors():
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _raise(error: Exception) -> Any:
    raise error


def _same(plugin: Any) -> Any:
    return plugin
