"""What code decides a number: hashes of modules and of all that they import."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Collection, Iterable
from importlib.machinery import ModuleSpec
from pathlib import Path

CORE = (
    "rlbench.frames",
    "rlbench.method",
    "rlbench.sampling",
    "rlbench.ops.dither",
    "rlbench.run",
    "rlbench.ops",
    "rlbench.clips.stored",
    "rlbench.clips.frame_files",
    "rlbench.clips.header",
    "rlbench.clips.in_memory",
    "rlbench.clips.decode_cache",
    "rlbench.clips.exr",
    "rlbench.benchmark.clip_sources",
    "rlbench.weights",
)  # the core's modules that decide what image a method makes of a clip


def code_hash(modules: Iterable[str], core: Iterable[str] = CORE) -> str:
    """Hash of the sources of `modules` and of the core modules that decide results, 16 hex digits.

    A package counts with all of its Python files, a module with its own. Nothing is imported but
    the packages that hold them. What they import in turn counts only if named (see `closure`).
    Raises LookupError for a module that cannot be found.
    """
    told = hashlib.sha256()
    for name in sorted({*modules, *core}):
        for place, path in _sources(name):
            source = hashlib.sha256(path.read_bytes()).hexdigest()
            told.update(f"{name} {place} {source}\n".encode())
    return told.hexdigest()[:16]


def import_closure(module: str, also: Collection[str] = ()) -> set[str]:
    """A module and all modules of its top-level package that it imports in turn, by name.

    Those of the top-level packages `also` count too. Imports are read from the sources, those
    inside functions too; nothing is imported but the packages that hold the modules.
    """
    return _reached([module], {module.partition(".")[0], *also})


def closure_of_file(file: Path, also: Collection[str]) -> set[str]:
    """The modules that a loose file imports in turn, of the packages `also` and of its folder."""
    beside = {each.stem for each in file.parent.iterdir() if each.suffix == ".py" or each.is_dir()}
    followed = {*also, *beside - {file.stem}}
    return _reached(_followed(_asked(file, ""), followed), followed)


def _reached(todo: list[str], followed: Collection[str]) -> set[str]:
    """The modules `todo`, and all that they import in turn of the top-level packages `followed`."""
    found: set[str] = set()
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += _followed(_imports(name), followed)
    return found


def _followed(names: Iterable[str], followed: Collection[str]) -> list[str]:
    """Those of names that are modules of the top-level packages `followed`."""
    return [name for name in names if name.partition(".")[0] in followed and _is_module(name)]


def _imports(name: str) -> list[str]:
    """What a module imports, as its source says, with the names that may be modules."""
    spec = _spec(name)
    if spec is None or not spec.origin or not spec.origin.endswith(".py"):
        return []
    package = name if spec.submodule_search_locations else name.rpartition(".")[0]
    return _asked(Path(spec.origin), package)


def _asked(file: Path, package: str) -> list[str]:
    """What a file of a package imports, with the names that may be modules."""
    try:
        tree = ast.parse(file.read_bytes())
    except SyntaxError:  # whoever imports it will hear of it
        return []
    asked: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            asked += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level and not package:
                continue  # of a loose file, which is in none
            if node.level:
                base = importlib.util.resolve_name("." * node.level + base, package)
            asked += [base, *(f"{base}.{alias.name}" for alias in node.names)]
    return asked


def _is_module(name: str) -> bool:
    """Is it a module, and not what one holds? A parent that is no package is not imported."""
    parent = name.rpartition(".")[0]
    above = _spec(parent) if parent else None
    return not (above and not above.submodule_search_locations) and _spec(name) is not None


def _spec(name: str) -> ModuleSpec | None:
    try:
        return importlib.util.find_spec(name)
    except Exception:  # what a parent raises that is imported for it; of a loose file, no spec
        return None


def _sources(name: str) -> list[tuple[str, Path]]:
    """The Python files of a module or package, each with its place in it."""
    spec = _spec(name)
    if spec and not spec.origin and spec.submodule_search_locations:  # a folder without __init__
        folders = [Path(each) for each in spec.submodule_search_locations]
        return [(p.relative_to(f).as_posix(), p) for f in folders for p in sorted(f.rglob("*.py"))]
    origin = spec.origin if spec else getattr(sys.modules.get(name), "__file__", None)
    if origin is None:
        raise LookupError(f"no source found for module '{name}'; is it installed?")
    file = Path(origin)
    if file.name != "__init__.py":
        return [(file.name, file)]
    return [(p.relative_to(file.parent).as_posix(), p) for p in sorted(file.parent.rglob("*.py"))]
