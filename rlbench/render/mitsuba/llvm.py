"""Finding a libLLVM that Dr.Jit can use, and starting Mitsuba with the fastest that works."""

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

MIN_VERSION = 16  # 14 is refused by Dr.Jit, 15 aborts the process
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
INSTALL_HINT = (
    "to trace several times faster, install LLVM 16 or newer: "
    "`apt-get install libllvm19`, `brew install llvm` or `conda install -c conda-forge libllvm19`"
)
PROBE = """
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
    """One libLLVM on this machine, and why it cannot be used, or an empty reason if it can."""

    path: Path
    version: int
    unusable_reason: str = ""


def find_candidates() -> list[tuple[int, Path]]:
    """Every libLLVM found here as (major version, file), newest first."""
    asked = os.environ.get("DRJIT_LIBLLVM_PATH")
    if asked:  # the user has chosen; it is probed all the same
        return [(_version(Path(asked)) or MIN_VERSION, Path(asked))]
    prefix = os.environ.get("CONDA_PREFIX", sys.prefix)
    files = [f for p in PATTERNS for f in glob.glob(p.replace("{CONDA_PREFIX}", prefix))]
    unique = {Path(f).resolve() for f in files}
    return sorted(((v, f) for f in unique if (v := _version(f))), reverse=True)


def probe_library(path: Path) -> str:
    """Why `path` cannot be used, or an empty string if it can; an unsuitable LLVM aborts."""
    return probe.probe_subprocess(PROBE, {"DRJIT_LIBLLVM_PATH": str(path)})


def find_libraries() -> list[LlvmLibrary]:
    """What was found, newest first, up to the first that can be used; each is probed only once."""
    note = paths.cache() / "llvm.json"
    found = []
    for version, path in find_candidates():
        if version < MIN_VERSION:
            found.append(LlvmLibrary(path, version, f"too old, {MIN_VERSION} or newer is needed"))
            continue
        key = f"{probe.file_stamp(path)} mitsuba {importlib.metadata.version('mitsuba')}"
        known = probe.read_result(note, key)
        reason = probe.store_result(note, key, probe_library(path)) if known is None else known
        found.append(LlvmLibrary(path, version, reason))
        if not reason:
            break
    return found


def select_variant(variant: str | None = None) -> str:
    """Start Mitsuba and return its variant.

    `variant`, or else the variable RLBENCH_VARIANT, asks for one by name, such as `llvm_ad_rgb`.
    Otherwise it is the one that is running already, or the fastest that works: `cuda_ad_rgb` with
    an NVIDIA device, `llvm_ad_rgb` with a libLLVM, or `scalar_rgb` with a warning. It must run
    before anything else imports drjit, which loads LLVM at once. It traces with RLBENCH_THREADS
    threads, or one for each processor.
    """
    if not variant and "mitsuba" in sys.modules and (runs := sys.modules["mitsuba"].variant()):
        _limit_threads()
        return str(runs)
    asked = variant or os.environ.get("RLBENCH_VARIANT", "")
    good = next((lib for lib in find_libraries() if not lib.unusable_reason), None)
    chosen = asked or fastest_variant(good, cuda.unusable_reason())
    _configure_drjit(good)
    import mitsuba as mi

    if chosen not in mi.variants():
        raise ValueError(f"Mitsuba has no variant '{chosen}'; it has: {', '.join(mi.variants())}")
    if not asked and chosen == "scalar_rgb":
        warnings.warn(f"no usable libLLVM: tracing is slow; {INSTALL_HINT}", stacklevel=2)
    mi.set_variant(chosen)
    _limit_threads()
    return str(mi.variant())


def fastest_variant(library: LlvmLibrary | None, cuda_refused: str | None) -> str:
    """The variant for a machine with this LLVM, where CUDA was refused so (see `cuda.refused`)."""
    if cuda_refused == "":
        return "cuda_ad_rgb"
    return "llvm_ad_rgb" if library else "scalar_rgb"


def report() -> str:
    """Which variant is used and with what, what was refused and why, how to get a fast one."""
    found, device = find_libraries(), cuda.unusable_reason()
    good = next((lib for lib in found if not lib.unusable_reason), None)
    chosen = fastest_variant(good, device)
    if chosen == "cuda_ad_rgb":
        using = f"with {cuda.find_driver()}"
    else:
        using = f"with {good.path}" if good else "no usable libLLVM"
    lines = [f"path tracer: {chosen}, {using}"]
    if device:
        lines.append(f"refused cuda_ad_rgb with {cuda.find_driver()}: {device}")
    lines += [f"refused {lib.path}: {lib.unusable_reason}" for lib in found if lib.unusable_reason]
    return "\n".join(lines if good or device == "" else [*lines, INSTALL_HINT])


def kernel_cache(library: LlvmLibrary | None) -> Path:
    """The folder of compiled kernels: Dr.Jit's own cache is not keyed by LLVM's version."""
    kind = f"llvm{library.version}" if library else "nollvm"
    return paths.cache() / f"drjit-{kind}-{_processor_id()}"


def _version(path: Path) -> int | None:
    """The major version as the file's name says it: libLLVM-15.so.1, libLLVM.so.19.1."""
    match = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path.name)
    match = match or re.search(r"llvm[-@/](\d+)", str(path), re.IGNORECASE)
    return int(match[1]) if match else None


def _configure_drjit(library: LlvmLibrary | None) -> None:
    """Tell Dr.Jit which LLVM to load, and where to keep kernels, unless the user has."""
    if library:
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library.path)
    if "DRJIT_CACHE_DIR" not in os.environ:
        folder = kernel_cache(library)
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["DRJIT_CACHE_DIR"] = str(folder)


def _limit_threads() -> None:
    import drjit as dr

    asked = os.environ.get("RLBENCH_THREADS", "")
    if asked.isdecimal() and 0 < int(asked) != dr.thread_count():
        dr.set_thread_count(int(asked))


def _processor_id() -> str:
    """A short name for this kind of processor: kernels of one may not run on another."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else [platform.processor()]
    kinds = sorted(
        {line for line in lines if re.match(r"model name|flags|Features|CPU part", line)}
    )
    words = "\n".join([platform.machine(), *(kinds or lines[:1])])
    return hashlib.sha256(words.encode()).hexdigest()[:8]
