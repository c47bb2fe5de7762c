"""Finding a libLLVM that Dr.Jit can use, and starting Mitsuba with it or without."""

from __future__ import annotations

import glob
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

from rlbench import paths

OLDEST = 16  # 14 is refused by Dr.Jit, 15 aborts the process
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
ADVICE = (
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
class Library:
    """One libLLVM on this machine, and why it cannot be used, or an empty reason if it can."""

    path: Path
    version: int
    refused: str = ""


def candidates() -> list[tuple[int, Path]]:
    """Every libLLVM found here as (major version, file), newest first."""
    asked = os.environ.get("DRJIT_LIBLLVM_PATH")
    if asked:  # the user has chosen; it is probed all the same
        return [(_version(Path(asked)) or OLDEST, Path(asked))]
    prefix = os.environ.get("CONDA_PREFIX", sys.prefix)
    files = [f for p in PATTERNS for f in glob.glob(p.replace("{CONDA_PREFIX}", prefix))]
    unique = {Path(f).resolve() for f in files}
    return sorted(((v, f) for f in unique if (v := _version(f))), reverse=True)


def probe(path: Path) -> str:
    """Why `path` cannot be used, or an empty string if it can.

    It runs in a process of its own, since an unsuitable LLVM aborts, and with an empty kernel
    cache, since kernels that another LLVM has compiled would hide the fault.
    """
    with tempfile.TemporaryDirectory() as empty:
        setting = {"DRJIT_LIBLLVM_PATH": str(path), "DRJIT_CACHE_DIR": empty}
        run = [sys.executable, "-c", PROBE]
        environment = {**os.environ, **setting}
        try:
            done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=120)
        except subprocess.TimeoutExpired:
            return "did not finish within 120 s"
    if done.returncode == 0 and done.stdout.startswith("usable"):
        return ""
    if done.returncode < 0:
        return f"ended by signal {-done.returncode} (LLVM too old or of another kind)"
    words = [line for line in done.stderr.splitlines() if line.strip()]
    return words[-1].strip()[:200] if words else f"exit code {done.returncode}"


def libraries() -> list[Library]:
    """What was found, newest first, up to the first that can be used; each is probed only once."""
    note = paths.cache() / "llvm.json"
    known: dict[str, str] = json.loads(note.read_text()) if note.exists() else {}
    found = []
    for version, path in candidates():
        if version < OLDEST:
            found.append(Library(path, version, f"too old, {OLDEST} or newer is needed"))
            continue
        key = _key(path)
        if key not in known:
            known[key] = probe(path)
            with paths.replacing(note) as file:
                file.write_text(json.dumps(known, indent=1))
        found.append(Library(path, version, known[key]))
        if not known[key]:
            break
    return found


def activate(variant: str | None = None) -> str:
    """Start Mitsuba and return its variant.

    `variant`, or else the variable RLBENCH_VARIANT, asks for one by name, such as `cuda_ad_rgb`.
    Otherwise it is the one that is running already, or `llvm_ad_rgb` where a usable libLLVM is
    found, or `scalar_rgb` with a warning. It must run before anything else imports drjit, which
    loads LLVM at once. It traces with RLBENCH_THREADS threads, or one for each processor.
    """
    if not variant and "mitsuba" in sys.modules and (runs := sys.modules["mitsuba"].variant()):
        _limit()
        return str(runs)
    asked = variant or os.environ.get("RLBENCH_VARIANT", "")
    good = next((lib for lib in libraries() if not lib.refused), None)
    if good:
        _prepare(good)
    import mitsuba as mi

    if not asked and not good:
        warnings.warn(f"no usable libLLVM: tracing is slow; {ADVICE}", stacklevel=2)
    mi.set_variant(asked or ("llvm_ad_rgb" if good else "scalar_rgb"))
    _limit()
    return str(mi.variant())


def report() -> str:
    """Which libLLVM is used, which were refused and why, and how to get the fast one."""
    found = libraries()
    lines = [f"refused {lib.path}: {lib.refused}" for lib in found if lib.refused]
    good = next((lib for lib in found if not lib.refused), None)
    if good:
        return "\n".join([f"path tracer: llvm_ad_rgb with {good.path}", *lines])
    return "\n".join(["path tracer: scalar_rgb, no usable libLLVM", *lines, ADVICE])


def _version(path: Path) -> int | None:
    """The major version as the file's name says it: libLLVM-15.so.1, libLLVM.so.19.1."""
    match = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path.name)
    match = match or re.search(r"llvm[-@/](\d+)", str(path), re.IGNORECASE)
    return int(match[1]) if match else None


def _key(path: Path) -> str:
    stamp = path.stat().st_mtime_ns if path.exists() else 0
    return f"{path} {stamp} mitsuba {importlib.metadata.version('mitsuba')}"


def _prepare(library: Library) -> None:
    """Name the library and a kernel cache of its own: Dr.Jit's is not keyed by LLVM's version."""
    os.environ["DRJIT_LIBLLVM_PATH"] = str(library.path)
    if "DRJIT_CACHE_DIR" not in os.environ:
        folder = paths.cache() / f"drjit-llvm{library.version}-{_processor()}"
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["DRJIT_CACHE_DIR"] = str(folder)


def _limit() -> None:
    import drjit as dr

    asked = os.environ.get("RLBENCH_THREADS", "")
    if asked.isdecimal() and 0 < int(asked) != dr.thread_count():
        dr.set_thread_count(int(asked))


def _processor() -> str:
    """A short name for this kind of processor: kernels of one may not run on another."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else [platform.processor()]
    kinds = sorted(
        {line for line in lines if re.match(r"model name|flags|Features|CPU part", line)}
    )
    words = "\n".join([platform.machine(), *(kinds or lines[:1])])
    return hashlib.sha256(words.encode()).hexdigest()[:8]
