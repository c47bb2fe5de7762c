"""Mitsuba's variants as fixtures: `llvm` skips where there is no libLLVM, `variant` is both."""

from __future__ import annotations

import pytest

from rlbench.render.llvm import activate, libraries

NO_LLVM = "no usable libLLVM on this machine (apt-get install libllvm19)"


@pytest.fixture
def llvm():
    if all(library.refused for library in libraries()):
        pytest.skip(NO_LLVM)
    return activate("llvm_ad_rgb")


@pytest.fixture(params=["llvm_ad_rgb", "scalar_rgb"])
def variant(request):
    if request.param == "llvm_ad_rgb":
        request.getfixturevalue("llvm")
    return activate(request.param)
