"""The Python that has bpy, or a reason why there is none."""

from __future__ import annotations

import pytest

from rlbench.render.cycles import process


@pytest.fixture(scope="session")
def blender():
    """The interpreter that can import bpy."""
    if not process.installed():
        pytest.skip(f"no bpy in {process.interpreter()}: {process.INSTALL}")
    return process.interpreter()


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch, request):
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "cache"))
