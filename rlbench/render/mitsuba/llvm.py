"""Finds a libLLVM that Dr.Jit can use, and selects Mitsuba's fastest variant that works."""

from __future__ import annotations

import glob
import hashlib
import importlib.metadata
import os
import platform
import re
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

from rlbench.render.mitsuba import cuda, probe
from rlbench.system import paths

__all__ = [
    "INSTALL_HINT",
    "MIN_VERSION",
    "WHEEL",
    "LlvmLibrary",
    "fastest_variant",
    "find_candidates",
    "find_libraries",
    "kernel_cache",
    "probe_library",
    "describe_variant",
    "select_variant",
    "wheel_files",
]

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
MISSING = "cannot open shared object file"  # what the loader says of a library that it needs
PROBE = """
import ctypes, os
ctypes.CDLL(os.environ["DRJIT_LIBLLVM_PATH"])  # raises what Dr.Jit does not say: a missing library
import drjit as dr
from drjit.llvm import Bool, Float, UInt32
lane = dr.opaque(UInt32, 3) + dr.arange(UInt32, 64)
x = dr.gather(Float, dr.linspace(Float, 0, 1, 128), lane, lane < 60)
x = dr.maximum(dr.minimum(x, Float(0.4)), Float(0.1))
_, x = dr.while_loop((UInt32(0), x), lambda i, x: i < 4, lambda i, x: (i + 1, x * 0.5))
total = dr.zeros(Float, 2)
dr.scatter_reduce(dr.ReduceOp.Add, total, x, lane & 1)
assert 0 < dr.sum(total)[0] < 64
print("usable", ".".join(map(str, dr.detail.llvm_version())))
"""


@dataclass(frozen=True)
class LlvmLibrary:
    """A libLLVM on this machine."""

    path: Path
    version: int  # major
    unusable_reason: str = ""  # empty if Dr.Jit can use it


def find_candidates() -> list[tuple[int, Path]]:
    """Every libLLVM on this machine as (major version, file), newest first."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    if chosen:
        return [(_version(Path(chosen)) or MIN_VERSION, Path(chosen))]
    prefix = os.environ.get("CONDA_PREFIX", sys.prefix)
    files = [f for p in PATTERNS for f in glob.glob(p.replace("{CONDA_PREFIX}", prefix))]
    unique = {path.resolve() for path in (*map(Path, files), *wheel_files())}
    return sorted(((v, f) for f in unique if (v := _version(f))), reverse=True)


def wheel_files() -> list[Path]:
    """Every libLLVM of the installed wheel, wherever pip put it: venv, user or system scheme."""
    try:
        files = importlib.metadata.files(WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    named = (Path(str(file.locate())) for file in files if file.name.startswith("libLLVM"))
    return [path for path in named if path.is_file()]


def probe_library(path: Path) -> str:
    """Why Dr.Jit cannot use a libLLVM, or an empty string; runs in a subprocess."""
    return probe.probe_subprocess(PROBE, {"DRJIT_LIBLLVM_PATH": str(path)})


def find_libraries() -> list[LlvmLibrary]:
    """Libraries from the newest to the first usable one.

    Each is probed once, but again while a library that it needs is missing.
    """
    cache = paths.cache_folder() / "llvm.json"
    libraries = []
    for version, path in find_candidates():
        if version < MIN_VERSION:
            libraries.append(
                LlvmLibrary(path, version, f"too old, {MIN_VERSION} or newer is needed")
            )
            continue
        key = f"{probe.file_stamp(path)} mitsuba {importlib.metadata.version('mitsuba')}"
        reason = probe.read_result(cache, key)
        if reason is None:
            reason = probe_library(path)
            if MISSING not in reason:
                probe.store_result(cache, key, reason)
        libraries.append(LlvmLibrary(path, version, reason))
        if not reason:
            break
    return libraries


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
    library = next((lib for lib in find_libraries() if not lib.unusable_reason), None)
    chosen = requested or fastest_variant(library, cuda.unusable_reason())
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


def fastest_variant(library: LlvmLibrary | None, cuda_reason: str | None) -> str:
    """The fastest variant given a usable libLLVM or None, and `cuda.unusable_reason()`."""
    if cuda_reason == "":
        return "cuda_ad_rgb"
    return "llvm_ad_rgb" if library else "scalar_rgb"


def describe_variant() -> str:
    """The variant in use, the libraries that cannot be used and why, and what to install."""
    libraries, cuda_reason = find_libraries(), cuda.unusable_reason()
    library = next((lib for lib in libraries if not lib.unusable_reason), None)
    chosen = fastest_variant(library, cuda_reason)
    if chosen == "cuda_ad_rgb":
        using = f"with {cuda.find_driver()}"
    else:
        using = f"with {library.path}" if library else "no usable libLLVM"
    lines = [f"path tracer: {chosen}, {using}"]
    if cuda_reason:
        lines.append(f"cannot use cuda_ad_rgb with {cuda.find_driver()}: {cuda_reason}")
    lines += [
        f"cannot use {lib.path}: {lib.unusable_reason}" for lib in libraries if lib.unusable_reason
    ]
    return "\n".join(lines if library or cuda_reason == "" else [*lines, INSTALL_HINT])


def kernel_cache(library: LlvmLibrary | None) -> Path:
    """Dr.Jit's folder of compiled kernels, one per LLVM version and processor.

    Dr.Jit itself does not key its cache by the version of LLVM.
    """
    name = f"llvm{library.version}" if library else "nollvm"
    return paths.cache_folder() / f"drjit-{name}-{_processor_id()}"


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
