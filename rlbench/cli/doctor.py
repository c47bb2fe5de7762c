"""What this machine has and lacks, and what would help."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rlbench import registry
from rlbench.clips.header import ClipError
from rlbench.clips.stored import read_header
from rlbench.system import paths, provenance

EXTRAS = {  # extra: what it gives, and a module of each package in it
    "oidn": ("Intel's own Open Image Denoise beside our retrained network", ("pyoidn",)),
    "train": ("reinforcement learning by ray's RLlib", ("ray", "gymnasium")),
    "ray": ("many workers for render and run", ("ray",)),
    "noisebase": ("clips of Noisebase", ("numcodecs",)),
    "dev": ("what make test needs", ("pytest", "ruff", "mypy", "importlinter", "hypothesis")),
}


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    topic: str
    fine: bool
    told: str  # what was found, and if it is not fine what would do


def examine() -> Iterator[Finding]:
    """Everything, one finding after the other; nothing is changed."""
    looks: tuple[Callable[[], Iterator[Finding]], ...] = (
        _versions,
        _device,
        _tracer,
        _cycles,
        _cache,
        _plugins,
        _extras,
    )
    for look in looks:
        yield from look()


def _versions() -> Iterator[Finding]:
    yield Finding("python", True, f"{platform.python_version()} on {platform.platform()}")
    for package in ("rlbench", "torch", "mitsuba", "OpenEXR", "numpy", "pandas"):
        try:
            yield Finding(package, True, importlib.metadata.version(package))
        except importlib.metadata.PackageNotFoundError:
            yield Finding(package, False, "not installed; pip install -e .")


def _device() -> Iterator[Finding]:
    import torch

    cores = f"{os.cpu_count()} cores, torch uses {torch.get_num_threads()} threads"
    yield Finding("processor", True, f"{provenance.machine().cpu}, {cores}")
    if torch.cuda.is_available():
        yield Finding("cuda", True, provenance.machine().gpu)
    else:
        yield Finding("cuda", True, "no device; everything runs on the processor")


def _tracer() -> Iterator[Finding]:
    from rlbench.render.mitsuba import llvm

    told = llvm.report()
    yield Finding("path tracer", "scalar" not in told.splitlines()[0], told)


def _cycles() -> Iterator[Finding]:
    from rlbench.render.cycles import process

    version, python = process.installed(), process.interpreter()
    if not version:
        told = f"a second tracer for .blend, USD, glTF: no bpy in {python}; {process.INSTALL}"
        yield Finding("extra cycles", True, told)
    elif version != process.VERSION:
        told = f"bpy {version} in {python}; rlbench was measured with {process.VERSION}"
        yield Finding("extra cycles", False, told)
    else:
        yield Finding("extra cycles", True, f"bpy {version} in {python}")


def _cache() -> Iterator[Finding]:
    whole, unfinished = [], []
    for folder in sorted(paths.clips().glob("*/*/")):
        try:
            whole.append(f"{folder.parent.name}/{read_header(folder).name}")
        except ClipError:
            unfinished.append(f"{folder.parent.name}/{folder.name}")
    told = f"{paths.clips()}: {len(whole)} clips"
    if unfinished:
        told += f"; unfinished, rlbench render resumes: {', '.join(unfinished)}"
    yield Finding("clips", not unfinished, told)
    there = next(p for p in (paths.cache(), *paths.cache().parents) if p.exists())
    free = shutil.disk_usage(there).free / 2**30
    told = f"{free:.1f} GiB free for {paths.cache()}, which holds {_gib(paths.cache()):.2f} GiB"
    yield Finding("disk", free > 2, told + ("" if free > 2 else "; set RLBENCH_CACHE elsewhere"))


def _plugins() -> Iterator[Finding]:
    for group in registry.GROUPS:
        names = registry.names(group)
        broken = {name: why for name in names if (why := registry.import_error(group, name))}
        told = ", ".join(names) or "none"
        told += "".join(f"; {name} is broken: {why}" for name, why in broken.items())
        yield Finding(group, not broken, told)


def _extras() -> Iterator[Finding]:
    for extra, (gives, modules) in EXTRAS.items():
        absent = [name for name in modules if importlib.util.find_spec(name) is None]
        if absent:
            hint = f"{gives}: without {', '.join(absent)}; pip install 'rlbench[{extra}]'"
            yield Finding(f"extra {extra}", True, hint)
        else:
            yield Finding(f"extra {extra}", True, f"{gives}: installed")


def _gib(folder: Path) -> float:
    return sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) / 2**30
