"""Code hashes: which source files decide a number, and one hash of their contents.

Imports are followed here by name, and not with `grimp`: that sees which module imports which, so
through the re-exports of one `__init__` a change to any operation would count for every method.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Collection, Iterable, Iterator
from functools import lru_cache
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import NamedTuple

OWN = "rlbench"  # the top-level package that every closure follows
INIT = ".__init__"  # suffix of a package that counts with its `__init__.py` alone

_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)

CORE = (
    "rlbench.frames",
    "rlbench.method",
    "rlbench.questions",
    "rlbench.sampling",
    "rlbench.ops.asking",
    "rlbench.ops.dither",
    "rlbench.ops.nested_tensors",
    "rlbench.ops.recording",
    "rlbench.ops.sanitize",
    "rlbench.ops.transfer",
    "rlbench.ops.upload",
    "rlbench.sanitize",
    "rlbench.run",
    "rlbench.clips.stored",
    "rlbench.clips.frame_files",
    "rlbench.clips.header",
    "rlbench.clips.in_memory",
    "rlbench.clips.decode_cache",
    "rlbench.clips.exr",
    "rlbench.clips.primaries",
    "rlbench.benchmark.clip_sources",
    "rlbench.weights",
)  # modules of rlbench that decide the image a method makes of a clip, whatever it imports itself


def code_hash(modules: Iterable[str], core: Iterable[str] = CORE) -> str:
    """Hash of the code of `modules` and `core`, 16 hex digits.

    Comments, docstrings and layout do not count, since no number depends on them. A module counts
    with its own file, a package with all of its Python files, and `package.__init__` with that file
    alone. Imports are not followed; see `import_closure`. No module is imported. Raises LookupError
    for a module without a source.
    """
    digest = hashlib.sha256()
    for name in sorted({*modules, *core}):
        for label, path in _sources(name):
            code = hashlib.sha256(_strip_prose(path.read_bytes())).hexdigest()
            digest.update(f"{name} {label} {code}\n".encode())
    return digest.hexdigest()[:16]


@lru_cache(maxsize=4096)
def _strip_prose(source: bytes) -> bytes:
    """The source without comments, docstrings and layout; as it is where Python cannot parse it."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return source
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    return ast.unparse(tree).encode()


def import_closure(module: str, also: Collection[str] = ()) -> set[str]:
    """The module and all modules that it imports, directly or not, as names for `code_hash`.

    Imports are followed into the module's own top-level package, rlbench, and the top-level
    packages `also`; those inside functions count too. Of `from package import name` only the module
    that defines the name counts, wherever the package's `__init__` (or its stub) imports it from. A
    package that is imported whole counts with its `__init__` and all that this imports. The sources
    are parsed; no module is imported.
    """
    followed = {module.partition(".")[0], OWN, *also}
    return _follow([_Import(module)], followed)


def closure_of_file(file: Path, also: Collection[str]) -> set[str]:
    """The modules that a plugin file imports, from rlbench, the packages `also` and its folder.

    The file itself is not among them, since it has no module name.
    """
    siblings = {p.stem for p in file.parent.iterdir() if p.suffix == ".py" or p.is_dir()}
    return _follow(_parse(file.read_bytes(), ""), {OWN, *also, *siblings - {file.stem}})


class _Import(NamedTuple):
    """`import module`, or `from module import name as alias`."""

    module: str
    name: str = ""
    alias: str = ""


def _follow(imports: Iterable[_Import], followed: Collection[str]) -> set[str]:
    """The modules that these imports reach inside the top-level packages `followed`."""
    closure: set[str] = set()
    queue = list(imports)
    while queue:
        for module in _defining_modules(queue.pop(), followed):
            if module not in closure:
                closure.add(module)
                queue += _imports(module)
    return closure


def _defining_modules(item: _Import, followed: Collection[str]) -> Iterator[str]:
    """The module whose source decides what is imported; none outside `followed`."""
    spec = _spec(item.module) if item.module.partition(".")[0] in followed else None
    if spec is None:
        return
    if spec.submodule_search_locations is None:
        yield item.module
        return
    package = f"{item.module}{INIT}"
    has_init = spec.origin is not None  # a folder without __init__.py is a package, too
    for reexport in _imports(package) if item.name and has_init else ():
        if reexport.alias == item.name and reexport.module != item.module:
            yield from _defining_modules(reexport, followed)
            return
    submodule = f"{item.module}.{item.name}"
    if item.name and _spec(submodule):
        yield from _defining_modules(_Import(submodule), followed)
    elif has_init:
        yield package


def _imports(name: str) -> tuple[_Import, ...]:
    """The imports of a module, or of `package.__init__` and its stub."""
    package = name.removesuffix(INIT) if name.endswith(INIT) else name.rpartition(".")[0]
    files = [path for _, path in _sources(name) if path.suffix == ".py"]
    stubs = [path.with_suffix(".pyi") for path in files if path.name == "__init__.py"]
    return tuple(
        item
        for path in [*files, *filter(Path.is_file, stubs)]
        for item in _parse(path.read_bytes(), package)
    )


@lru_cache(maxsize=4096)
def _parse(source: bytes, package: str) -> tuple[_Import, ...]:
    """The imports of a source; relative ones are resolved against `package`."""
    try:
        tree = ast.parse(source)
    except SyntaxError:  # importing the module reports it
        return ()
    return tuple(item for node in ast.walk(tree) for item in _read_import(node, package))


def _read_import(node: ast.AST, package: str) -> Iterator[_Import]:
    if isinstance(node, ast.Import):
        yield from (_Import(alias.name) for alias in node.names)
    if isinstance(node, ast.ImportFrom) and (package or not node.level):
        base = "." * node.level + (node.module or "")
        module = importlib.util.resolve_name(base, package) if node.level else base
        for alias in node.names:
            name = "" if alias.name == "*" else alias.name
            yield _Import(module, name, alias.asname or name)


def _spec(name: str) -> ModuleSpec | None:
    """Where a module lies. Unlike `importlib.util.find_spec`, imports no parent package."""
    top, *parts = name.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except ValueError:  # imported from a file, so it has no spec
        return None
    for part in parts:
        if spec is None or spec.submodule_search_locations is None:
            return None
        spec = PathFinder.find_spec(f"{spec.name}.{part}", spec.submodule_search_locations)
    return spec


def _sources(name: str) -> list[tuple[str, Path]]:
    """The Python files that a name counts with, each with its path inside the package."""
    spec = _spec(name)
    if spec and not spec.origin and spec.submodule_search_locations:  # a folder without __init__.py
        return [pair for folder in spec.submodule_search_locations for pair in _files(Path(folder))]
    origin = spec.origin if spec else getattr(sys.modules.get(name), "__file__", None)
    if origin is None:
        raise LookupError(f"no source file found for module '{name}'. Check that it is installed")
    file = Path(origin)
    if file.name != "__init__.py" or name.endswith(INIT):
        return [(file.name, file)]
    return _files(file.parent)


def _files(folder: Path) -> list[tuple[str, Path]]:
    return [(path.relative_to(folder).as_posix(), path) for path in sorted(folder.rglob("*.py"))]
