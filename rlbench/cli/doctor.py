"""The command doctor: what is installed on this machine, and what would help."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from rlbench import registry
from rlbench.checks.result import CheckResult, not_applicable, passed, warning
from rlbench.cli import options
from rlbench.cli.json_output import show_checks
from rlbench.cli.methods import load_plugins
from rlbench.registry import apps
from rlbench.system import paths, provenance

MIN_FREE_GIB = 2  # of disk space, below which a warning is shown
EXTRAS = {  # extra: what it adds, and a module of each of its packages
    "oidn": ("Intel's own Open Image Denoise library beside our network", ("pyoidn",)),
    "train": ("reinforcement learning with Ray RLlib", ("ray", "gymnasium")),
    "ray": ("parallel workers for render and run", ("ray",)),
    "noisebase": ("clips of Noisebase", ("numcodecs",)),
    "flip": ("FLIP and HDR-FLIP in rlbench evaluate", ("flip_evaluator",)),
    "cvvdp": ("ColorVideoVDP in rlbench evaluate", ("pycvvdp",)),
    "lpips": ("LPIPS in rlbench evaluate", ("lpips",)),
    "video": ("MP4 files in rlbench video", ("imageio_ffmpeg",)),
    "dev": ("tools for make test", ("pytest", "ruff", "mypy", "importlinter", "hypothesis")),
}


def doctor(plugin: options.Plugins = None, as_json: options.Json = False) -> None:
    """Report what this machine has, lacks, and how to get it.

    Examples:

    \b
      rlbench doctor
    """
    load_plugins(plugin, allow_broken=True)
    show_checks([(platform.node() if as_json else "", inspect_machine())], as_json)


def inspect_machine() -> Iterator[CheckResult]:
    """The result of every check of this machine, one after the other. Nothing is changed."""
    checks: tuple[Callable[[], Iterator[CheckResult]], ...] = (
        _check_versions,
        _check_devices,
        _check_apps,
        _check_clips,
        _check_disk,
        _check_plugins,
        _check_extras,
    )
    for check in checks:
        yield from check()


def _check_versions() -> Iterator[CheckResult]:
    yield passed("python", f"{platform.python_version()} on {platform.platform()}")
    for package in ("rlbench", "torch", "mitsuba", "OpenEXR", "numpy", "pandas"):
        try:
            yield passed(package, importlib.metadata.version(package))
        except importlib.metadata.PackageNotFoundError:
            yield warning(package, "not installed", "pip install -e .")


def _check_devices() -> Iterator[CheckResult]:
    import torch

    from rlbench.system.half_precision import describe_half

    cores = f"{os.cpu_count()} cores, torch uses {torch.get_num_threads()} threads"
    yield passed("processor", f"{provenance.machine().cpu}, {cores}")
    yield passed("processor half precision", describe_half("cpu"))
    yield _check_openvino()
    if torch.cuda.is_available():
        yield passed("cuda", f"{provenance.machine().gpu}, {provenance.compute_software('cuda')}")
        yield passed("cuda half precision", describe_half("cuda"))
    else:
        yield not_applicable("cuda", "no device; everything runs on the processor")


def _check_openvino() -> CheckResult:
    try:
        version = importlib.metadata.version("openvino")
    except importlib.metadata.PackageNotFoundError:
        hint = "pip install 'rlbench[openvino]'"
        return warning("openvino", "not installed; --backend openvino needs it", hint)
    return passed("openvino", f"{version}; --backend openvino can be used")


def _check_apps() -> Iterator[CheckResult]:
    for check in apps.load_parts("machine_checks"):
        yield from check()


def _check_clips() -> Iterator[CheckResult]:
    from rlbench.clips.header import ClipError, read_header

    finished, unfinished = [], []
    for folder in sorted(paths.clips_folder().glob("*/*/")):
        try:
            finished.append(f"{folder.parent.name}/{read_header(folder).name}")
        except ClipError:
            unfinished.append(f"{folder.parent.name}/{folder.name}")
    found = f"{paths.clips_folder()}: {len(finished)} clips"
    if unfinished:
        found += f"; unfinished: {', '.join(unfinished)}"
        yield warning("clips", found, "rlbench render resumes unfinished clips")
    else:
        yield passed("clips", found)


def _check_disk() -> Iterator[CheckResult]:
    cache = paths.cache_folder()
    existing = next(path for path in (cache, *cache.parents) if path.exists())
    free = shutil.disk_usage(existing).free / 2**30
    found = f"{free:.1f} GiB free for {cache}, which holds {_size_gib(cache):.2f} GiB"
    if free > MIN_FREE_GIB:
        yield passed("disk", found)
    else:
        yield warning("disk", found, "set RLBENCH_CACHE to a folder on a larger disk")


def _check_plugins() -> Iterator[CheckResult]:
    for group in registry.GROUPS:
        names = registry.list_plugins(group)
        errors = {name: error for name in names if (error := registry.import_error(group, name))}
        found = ", ".join(names) or "none"
        found += "".join(f"; {name} cannot be imported: {why}" for name, why in errors.items())
        if errors:
            yield warning(group, found, f"correct or uninstall: {', '.join(errors)}")
        else:
            yield passed(group, found)


def _check_extras() -> Iterator[CheckResult]:
    for extra, (purpose, modules) in EXTRAS.items():
        missing = [name for name in modules if importlib.util.find_spec(name) is None]
        if missing:
            found = f"{', '.join(missing)} not installed: pip install 'rlbench[{extra}]'"
            yield not_applicable(f"extra {extra}", f"{purpose}; {found}")
        else:
            yield passed(f"extra {extra}", f"{purpose}; installed")


def _size_gib(folder: Path) -> float:
    return sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) / 2**30
