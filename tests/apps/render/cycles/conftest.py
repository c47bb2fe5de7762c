"""The Python that has bpy, as a fixture; skips if there is none."""

from __future__ import annotations

import pytest

from rlbench.apps.render.cycles import process


@pytest.fixture(scope="session")
def blender():
    """The interpreter that can import bpy."""
    if not process.bpy_version():
        pytest.skip(f"no bpy in {process.interpreter()}: {process.INSTALL_HINT}")
    return process.interpreter()


@pytest.fixture(autouse=True, scope="session")
def _own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
