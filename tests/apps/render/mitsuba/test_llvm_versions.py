"""The wheel's libLLVM and the distribution's give the same clip."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.render.mitsuba import variant

SCENES = ("room", "city", "temple", "hall", "ripples")
TRACE = """
import sys
import drjit
import numpy as np
from rlbench.apps.render.jobs.render_clips import scene_of_clip
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from tests.apps.render.small_scenes import room
arrays = {}
for name in sys.argv[2:]:
    tracer = open_tracer(room() if name == "room" else scene_of_clip(name), 32, 32)
    tracer.set_time(1.0)
    arrays[name] = tracer.trace_images(8)
    arrays |= {f"{name} {buffer}": image for buffer, image in render_gbuffer(tracer).items()}
arrays["version"] = np.array(drjit.detail.llvm_version())
np.savez(sys.argv[1], **arrays)
"""


def trace(library: Path, folder: Path) -> dict[str, np.ndarray]:
    """Samples and G-buffer of every scene, traced by a process that uses `library`."""
    file = folder / f"{library.name}.npz"
    variables = {
        "DRJIT_LIBLLVM_PATH": str(library),
        "RLBENCH_CACHE": str(folder / library.name),  # compiled kernels too
        "RLBENCH_VARIANT": "llvm_ad_rgb",
        "PYTHONPATH": str(Path(__file__).parents[4]),
    }
    command = [sys.executable, "-c", TRACE, str(file), *SCENES]
    subprocess.run(command, env={**os.environ, **variables}, check=True, timeout=600)
    with np.load(file) as arrays:
        return dict(arrays)


def deviating_share(a: np.ndarray, b: np.ndarray) -> float:
    """The share of values that differ by more than 1e-4 of themselves."""
    return float(1 - np.isclose(a, b, rtol=1e-4, atol=1e-6, equal_nan=True).mean())


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """What the wheel's library and another one trace."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("DRJIT_LIBLLVM_PATH", raising=False)  # set where a variant is selected
        found = variant.find_libraries()
        patch.setattr(variant, "wheel_files", lambda: [])
        others = variant.find_libraries()
    files = {path.resolve() for path in variant.wheel_files()}
    wheel = next((each.path for each in found if not each.fault and each.path in files), None)
    other = next((each.path for each in others if not each.fault and each.path not in files), None)
    if wheel is None:
        pytest.skip(f"the wheel {variant.WHEEL} is not installed, or Dr.Jit cannot use its library")
    if other is None:
        pytest.skip("no usable libLLVM beside the wheel's (apt-get install libllvm19)")
    folder = tmp_path_factory.mktemp("llvm")
    return trace(wheel, folder), trace(other, folder)


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_two_versions_of_llvm_trace_the_same_samples_and_buffers(pair, scene):
    wheel, other = pair
    assert tuple(wheel["version"]) != tuple(other["version"])
    for name in [key for key in wheel if key.split()[0] == scene]:
        assert deviating_share(wheel[name], other[name]) <= 1e-3, name
