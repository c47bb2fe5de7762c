"""Mitsuba's variants as fixtures: `llvm` skips where there is no libLLVM, `variant` is both."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from rlbench.render.mitsuba.llvm import find_libraries, select_variant
from rlbench.system import paths

NO_LLVM = "no usable libLLVM on this machine (apt-get install libllvm19)"


@pytest.fixture(scope="session")
def noted(tmp_path_factory) -> Path:
    """What probing libLLVM has found, once for all tests: each has an empty cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(tmp_path_factory.mktemp("probed")))
        find_libraries()
        return paths.cache() / "llvm.json"


@pytest.fixture(autouse=True)
def _probed(noted, _own_cache):
    paths.cache().mkdir(parents=True, exist_ok=True)
    if noted.exists():
        shutil.copy(noted, paths.cache())


@pytest.fixture
def llvm():
    if all(library.unusable_reason for library in find_libraries()):
        pytest.skip(NO_LLVM)
    return select_variant("llvm_ad_rgb")


@pytest.fixture(params=["llvm_ad_rgb", "scalar_rgb"])
def variant(request):
    if request.param == "llvm_ad_rgb":
        request.getfixturevalue("llvm")
    return select_variant(request.param)


@pytest.fixture(autouse=True)
def _fast_again():
    """What a test leaves running is what the next ones get: not the slow variant."""
    yield
    running = sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None
    if running == "scalar_rgb" and not all(library.unusable_reason for library in find_libraries()):
        select_variant("llvm_ad_rgb")
