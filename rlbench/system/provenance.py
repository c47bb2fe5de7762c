"""Where a number came from: this machine, the versions, the commit, the code that made it."""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import importlib.util
import os
import platform
import subprocess
import sys
from collections.abc import Collection, Iterable
from dataclasses import dataclass
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
PACKAGES = ("torch", "mitsuba", "rlbench")


@dataclass(frozen=True)
class Machine:
    """What a time was measured on. `gpu` is empty where there is none."""

    cpu: str
    cores: int  # that this process may use
    gpu: str
    os: str

    @property
    def name(self) -> str:
        """The processor and the cores of it that work: a tracer's time needs both."""
        return f"{self.cpu}, {self.cores} cores"


def machine() -> Machine:
    """This machine."""
    allowed = getattr(os, "sched_getaffinity", None)
    cores = len(allowed(0)) if allowed else os.cpu_count() or 1
    return Machine(_cpu(), cores, _gpu(), f"{platform.system()} {platform.release()}")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide results; "none" if not installed."""
    return {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}}


def releases(packages: Iterable[str]) -> str:
    """The packages and their versions, `pyoidn 2.5.1.0`; of one that is not installed, "none"."""
    return ", ".join(f"{name} {_version(name)}" for name in packages)


def missing(packages: Iterable[str]) -> list[str]:
    """Those of the packages that are not installed."""
    return [name for name in packages if _version(name) == "none"]


def commit(folder: Path = Path(__file__).parents[1]) -> str:
    """The commit of the checkout that tracks this code, 12 hex digits, with "+" if it was changed.

    Empty where the code is no checkout, as when it was installed from a package.
    """
    tracked = _git(folder, "ls-files", "--error-unmatch", "--", ".")
    head = _git(folder, "rev-parse", "--short=12", "HEAD") if tracked else ""
    changed = _git(folder, "status", "--porcelain") if head else ""
    return f"{head}+" if changed else head


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


def closure(module: str, also: Collection[str] = ()) -> set[str]:
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


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _gpu() -> str:
    try:
        import torch
    except ImportError:
        return ""
    return str(torch.cuda.get_device_name(0)) if torch.cuda.is_available() else ""


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _git(folder: Path, *words: str) -> str:
    """What git prints, or nothing where it fails or is absent."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("GIT_")}  # as set in hooks
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *words], capture_output=True, text=True, env=clean
        )
    except FileNotFoundError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
