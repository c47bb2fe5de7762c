"""Provenance of a result: the machine, the package versions and the commit."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("torch", "mitsuba", "rlbench")  # their versions decide results


@dataclass(frozen=True)
class Machine:
    """A machine on which times are measured."""

    cpu: str
    cores: int  # available to this process
    gpu: str  # empty without a CUDA device
    os: str

    @property
    def name(self) -> str:
        """Processor and number of cores: the time of a path tracer depends on both."""
        return f"{self.cpu}, {self.cores} cores"


def machine() -> Machine:
    """Describe this machine."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux only
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    return Machine(_cpu(), cores, _gpu(), f"{platform.system()} {platform.release()}")


def versions() -> dict[str, str]:
    """Versions of Python and of `PACKAGES`; "none" for a package that is not installed."""
    return {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}}


def package_versions(packages: Iterable[str]) -> str:
    """The packages with their versions, as one text; "none" for one that is not installed.

    >>> package_versions(["no-such-package"])
    'no-such-package none'
    """
    return ", ".join(f"{name} {_version(name)}" for name in packages)


def compute_software(device_type: str) -> str:
    """The version of PyTorch and, for "cuda", of CUDA and the card's driver: they change times.

    >>> compute_software("cpu").split()[0]
    'torch'
    """
    parts = [package_versions(["torch"])]
    if device_type == "cuda":
        import torch

        driver = _run("nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader")
        parts += [f"CUDA {torch.version.cuda}", f"driver {driver.partition(chr(10))[0] or '?'}"]
    return ", ".join(parts)


def missing_packages(packages: Iterable[str]) -> list[str]:
    """The packages that are not installed."""
    return [name for name in packages if _version(name) == "none"]


def commit(folder: Path = Path(__file__).parents[1]) -> str:
    """The commit of the checkout that holds this code: 12 hex digits, and "+" if files changed.

    Empty if the code is not tracked by git, for example if it was installed from a wheel.
    """
    tracked_files = _git(folder, "ls-files", "--error-unmatch", "--", ".")
    head = _git(folder, "rev-parse", "--short=12", "HEAD") if tracked_files else ""
    changes = _git(folder, "status", "--porcelain") if head else ""
    return f"{head}+" if changes else head


def _cpu() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
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


def _git(folder: Path, *arguments: str) -> str:
    """The output of a git command; empty if it fails or git is not installed."""
    return _run("git", "-C", str(folder), *arguments)


def _run(*words: str) -> str:
    """The output of a command; empty if it fails or is not installed."""
    # a git hook sets GIT_DIR and others, which would point to another repository
    environment = {k: v for k, v in os.environ.items() if not k.startswith("GIT_")}
    try:
        process = subprocess.run(words, capture_output=True, text=True, env=environment)
    except FileNotFoundError:
        return ""
    return process.stdout.strip() if process.returncode == 0 else ""
