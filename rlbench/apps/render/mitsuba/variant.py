"""Selects Mitsuba's fastest variant that works here: CUDA, else LLVM, else scalar.

On Linux x86-64 libLLVM comes with the packages, elsewhere from the system. A driver of CUDA is
tried in a subprocess, because an unusable one may abort the process.
"""

from __future__ import annotations

import ctypes
import glob
import hashlib
import importlib.metadata
import os
import platform
import re
import subprocess
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

from rlbench.system import paths, store

MIN_VERSION = 16  # Dr.Jit refuses 14; 15 aborts the process
PATTERNS = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib/wsl/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    f"{sys.prefix}/lib/libLLVM*",
    "{CONDA_PREFIX}/lib/libLLVM*",
)
WHEEL = "karellen-llvm-core"  # a dependency on Linux x86-64; its files lie outside site-packages
INSTALL_HINT = (
    "to trace several times faster, install LLVM 16 or newer: on Linux x86-64 "
    f"`pip install {WHEEL}` and, if libatomic.so.1 is missing, `apt-get install libatomic1`; "
    "elsewhere `apt-get install libllvm19`, `brew install llvm` or "
    "`conda install -c conda-forge libllvm19`"
)
CUDA_DRIVERS = (
    "/usr/lib/*/libcuda.so.1",
    "/usr/lib64/libcuda.so.1",
    "/usr/lib/libcuda.so.1",
    "/usr/lib/wsl/lib/libcuda.so.1",
    "/usr/local/nvidia/lib64/libcuda.so.1",
)
CUDA_PROBE = """
import mitsuba as mi
mi.set_variant("cuda_ad_rgb")
scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}, "sky": {"type": "constant"}})
lanes = mi.Float([0.1, 0.2, 9.0])
hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(lanes, 0, -5), mi.Vector3f(0, 0, 1)))
assert hit.is_valid().numpy().tolist() == [True, True, False]
"""
PROBE_TIMEOUT_S = 120


@dataclass(frozen=True)
class LlvmLibrary:
    """A libLLVM on this machine."""

    path: Path
    version: int  # major
    fault: str = ""  # why Dr.Jit cannot use it; empty if it can


def select_variant(variant: str | None = None) -> str:
    """Set Mitsuba's variant and return its name.

    The argument, or else the environment variable RLBENCH_VARIANT, names a variant such as
    `llvm_ad_rgb`. By default it is the variant already set, or the fastest that works:
    `cuda_ad_rgb` with an NVIDIA device, `llvm_ad_rgb` with a libLLVM, `scalar_rgb` with a warning.
    Call this before anything else imports drjit, which loads LLVM on import. The variable
    RLBENCH_THREADS limits the threads; default one per processor.

    Raises ValueError for a variant that Mitsuba does not have.
    """
    if not variant and "mitsuba" in sys.modules and (current := sys.modules["mitsuba"].variant()):
        _limit_threads()
        return str(current)
    requested = variant or os.environ.get("RLBENCH_VARIANT", "")
    library = next((each for each in find_libraries() if not each.fault), None)
    chosen = requested or fastest_variant(library, cuda_fault())
    _configure_drjit(library)
    import mitsuba as mi

    if chosen not in mi.variants():
        raise ValueError(
            f"Mitsuba has no variant '{chosen}'; available: {', '.join(mi.variants())}"
        )
    if not requested and chosen == "scalar_rgb":
        warnings.warn(f"no usable libLLVM: tracing is slow; {INSTALL_HINT}", stacklevel=2)
    mi.set_variant(chosen)
    _limit_threads()
    return str(mi.variant())


def fastest_variant(library: LlvmLibrary | None, cuda: str | None) -> str:
    """The fastest variant given a usable libLLVM or None, and `cuda_fault()`."""
    if cuda == "":
        return "cuda_ad_rgb"
    return "llvm_ad_rgb" if library else "scalar_rgb"


def describe_variant() -> str:
    """The variant in use, the libraries that cannot be used and why, and what to install."""
    libraries, cuda = find_libraries(), cuda_fault()
    library = next((each for each in libraries if not each.fault), None)
    chosen = fastest_variant(library, cuda)
    if chosen == "cuda_ad_rgb":
        using = f"with {find_cuda_driver()}"
    else:
        using = f"with {library.path}" if library else "no usable libLLVM"
    lines = [f"path tracer: {chosen}, {using}"]
    if cuda:
        lines.append(f"cannot use cuda_ad_rgb with {find_cuda_driver()}: {cuda}")
    lines += [f"cannot use {each.path}: {each.fault}" for each in libraries if each.fault]
    return "\n".join(lines if library or cuda == "" else [*lines, INSTALL_HINT])


def find_libraries() -> list[LlvmLibrary]:
    """The libraries of this machine in the order of preference, up to the first usable one.

    The variable DRJIT_LIBLLVM_PATH names the only one. Without it, the wheel's come first, then
    those of the system, newest first.
    """
    if chosen := os.environ.get("DRJIT_LIBLLVM_PATH"):
        candidates = [(_version(Path(chosen)) or MIN_VERSION, Path(chosen))]
    else:
        prefix = os.environ.get("CONDA_PREFIX", sys.prefix)
        found = [f for p in PATTERNS for f in glob.glob(p.replace("{CONDA_PREFIX}", prefix))]
        wheel = {path.resolve() for path in wheel_files()}
        system = {Path(file).resolve() for file in found} - wheel
        candidates = [
            (version, path)
            for group in (wheel, system)
            for version, path in sorted(((_version(f) or 0, f) for f in group), reverse=True)
            if version
        ]
    libraries = []
    for version, path in candidates:
        libraries.append(LlvmLibrary(path, version, _find_fault(path, version)))
        if not libraries[-1].fault:
            break
    return libraries


def wheel_files() -> list[Path]:
    """Every libLLVM of the installed wheel, wherever pip put it: venv, user or system scheme."""
    try:
        files = importlib.metadata.files(WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    named = (Path(str(file.locate())) for file in files if file.name.startswith("libLLVM"))
    return [path for path in named if path.is_file()]


def kernel_cache(library: LlvmLibrary | None) -> Path:
    """Dr.Jit's folder of compiled kernels, one per LLVM version and processor.

    Dr.Jit itself does not key its cache by the version of LLVM.
    """
    name = f"llvm{library.version}" if library else "nollvm"
    return paths.cache_folder() / f"drjit-{name}-{_processor_id()}"


def find_cuda_driver() -> Path | None:
    """The library of the NVIDIA driver, or None if none is installed."""
    files = sorted(file for pattern in CUDA_DRIVERS for file in glob.glob(pattern))
    return Path(files[0]).resolve() if files else None


def cuda_fault() -> str | None:
    """Why Mitsuba cannot trace with CUDA; empty if it can; None without an NVIDIA driver.

    Mitsuba needs the driver's OptiX, which containers often lack. A subprocess traces three rays,
    once for each version of the driver and of Mitsuba; the result is cached.
    """
    driver = find_cuda_driver()
    if driver is None:
        return None
    changed = driver.stat().st_mtime_ns if driver.exists() else 0
    key = f"{driver} {changed} mitsuba {importlib.metadata.version('mitsuba')}"
    return store.recall(paths.cache_folder() / "cuda.json", key, lambda: _run_probe(CUDA_PROBE))


def _run_probe(code: str) -> str:
    """Why a subprocess that runs `code` fails; empty if it does not."""
    command = [sys.executable, "-c", code]
    try:
        process = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return f"did not finish within {PROBE_TIMEOUT_S} s"
    if process.returncode < 0:
        return f"ended by signal {-process.returncode} (too old or incompatible)"
    lines = [line for line in process.stderr.splitlines() if line.strip()]
    fault = lines[-1].strip()[:200] if lines else f"exit code {process.returncode}"
    return fault if process.returncode else ""


def _find_fault(path: Path, version: int) -> str:
    """Why Dr.Jit cannot use a libLLVM, such as a library that it needs; empty if it can."""
    if version < MIN_VERSION:
        return f"too old, {MIN_VERSION} or newer is needed"
    try:
        ctypes.CDLL(str(path))
    except OSError as error:
        return str(error)
    return ""


def _version(path: Path) -> int | None:
    """The major version in a file name: libLLVM-15.so.1, libLLVM.so.19.1."""
    match = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path.name)
    match = match or re.search(r"llvm[-@/](\d+)", str(path), re.IGNORECASE)
    return int(match[1]) if match else None


def _configure_drjit(library: LlvmLibrary | None) -> None:
    """Set the variables that give Dr.Jit its libLLVM and, unless already set, its kernel cache."""
    if library:
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library.path)
    if "DRJIT_CACHE_DIR" not in os.environ:
        folder = kernel_cache(library)
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["DRJIT_CACHE_DIR"] = str(folder)


def _limit_threads() -> None:
    import drjit as dr

    threads = os.environ.get("RLBENCH_THREADS", "")
    if threads.isdecimal() and 0 < int(threads) != dr.thread_count():
        dr.set_thread_count(int(threads))


def _processor_id() -> str:
    """A short hash of the processor type; kernels compiled for one may not run on another."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else [platform.processor()]
    types = sorted(
        {line for line in lines if re.match(r"model name|flags|Features|CPU part", line)}
    )
    text = "\n".join([platform.machine(), *(types or lines[:1])])
    return hashlib.sha256(text.encode()).hexdigest()[:8]
