"""Checks whether Mitsuba can trace on this machine's NVIDIA device."""

from __future__ import annotations

import glob
import importlib.metadata
from pathlib import Path

from rlbench.render.mitsuba import probe
from rlbench.system import paths

__all__ = ["find_driver", "unusable_reason"]

DRIVERS = (
    "/usr/lib/*/libcuda.so.1",
    "/usr/lib64/libcuda.so.1",
    "/usr/lib/libcuda.so.1",
    "/usr/lib/wsl/lib/libcuda.so.1",
    "/usr/local/nvidia/lib64/libcuda.so.1",
)
PROBE = """
import mitsuba as mi
mi.set_variant("cuda_ad_rgb")
scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}, "sky": {"type": "constant"}})
lanes = mi.Float([0.1, 0.2, 9.0])
hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(lanes, 0, -5), mi.Vector3f(0, 0, 1)))
assert hit.is_valid().numpy().tolist() == [True, True, False]
print("usable")
"""


def find_driver() -> Path | None:
    """The library of the NVIDIA driver, or None if none is installed."""
    files = sorted(file for pattern in DRIVERS for file in glob.glob(pattern))
    return Path(files[0]).resolve() if files else None


def unusable_reason() -> str | None:
    """Why Mitsuba cannot trace with CUDA; empty if it can; None without an NVIDIA driver.

    Mitsuba needs the driver's OptiX, which containers often lack. A subprocess traces three rays,
    once for each version of the driver and of Mitsuba; the result is cached.
    """
    library = find_driver()
    if library is None:
        return None
    cache = paths.cache_folder() / "cuda.json"
    key = f"{probe.file_stamp(library)} mitsuba {importlib.metadata.version('mitsuba')}"
    cached = probe.read_result(cache, key)
    if cached is not None:
        return cached
    return probe.store_result(cache, key, probe.probe_subprocess(PROBE, {}))
