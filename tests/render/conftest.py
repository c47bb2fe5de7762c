"""Mitsuba's variants as fixtures: `llvm` skips without a libLLVM, `variant` runs both variants."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from rlbench.render.mitsuba.llvm import find_libraries, select_variant
from rlbench.system import paths

NO_LLVM = "no usable libLLVM on this machine (apt-get install libllvm19)"


@pytest.fixture(scope="session")
def probe_results(tmp_path_factory) -> Path:
    """Results of probing libLLVM, shared by all tests, each of which has an empty cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(tmp_path_factory.mktemp("probed")))
        find_libraries()
        return paths.cache_folder() / "llvm.json"


@pytest.fixture(autouse=True)
def _probed(probe_results, _own_cache):
    paths.cache_folder().mkdir(parents=True, exist_ok=True)
    if probe_results.exists():
        shutil.copy(probe_results, paths.cache_folder())


@pytest.fixture(scope="session")
def usable_llvm():
    if all(library.unusable_reason for library in find_libraries()):
        pytest.skip(NO_LLVM)


@pytest.fixture
def llvm(usable_llvm):
    return select_variant("llvm_ad_rgb")


@pytest.fixture(params=["llvm_ad_rgb", "scalar_rgb"])
def variant(request):
    if request.param == "llvm_ad_rgb":
        request.getfixturevalue("llvm")
    return select_variant(request.param)


@pytest.fixture(autouse=True)
def _fast_again():
    """The variant that a test sets stays for the next ones: do not leave them the slow one."""
    yield
    running = sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None
    if running == "scalar_rgb" and not all(library.unusable_reason for library in find_libraries()):
        select_variant("llvm_ad_rgb")
