"""Where a number came from: this machine, the versions, the commit, the code that made it."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

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


def package_versions(packages: Iterable[str]) -> str:
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
