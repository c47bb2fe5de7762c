"""Mitsuba's variants as fixtures, and a server of a scene.

`llvm` skips without a libLLVM, `variant` runs both variants.
"""

from __future__ import annotations

import sys
from contextlib import contextmanager

import pytest

from rlbench import registry
from rlbench.apps.render.mitsuba.variant import find_libraries, select_variant
from rlbench.system import paths
from tests.scene_server import SceneServer

NO_LLVM = "no usable libLLVM on this machine (apt-get install libllvm19)"


@pytest.fixture(scope="session")
def usable_llvm():
    if all(library.fault for library in find_libraries()):
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
def _no_settings(monkeypatch):
    """No mirror or server of the user."""
    for name in ("RLBENCH_SCENES", "RLBENCH_SCENES_URL", "RLBENCH_SCENES_API"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def server(tmp_path, _no_settings):
    """A server of the scene `attic`, which is pinned."""
    served = SceneServer(tmp_path / "repository")
    served.write_pin()
    yield served
    served.close()


@pytest.fixture(autouse=True)
def _fast_again():
    """The variant that a test sets stays for the next ones: do not leave them the slow one."""
    yield
    running = sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None
    if running == "scalar_rgb" and not all(library.fault for library in find_libraries()):
        select_variant("llvm_ad_rgb")


def launches(work):
    """The kernels that `work` launches, and what it returns."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        returned = work()
        return dr.kernel_history([dr.KernelType.JIT]), returned


def check_no_kernel_is_compiled(work):
    """`work` launches kernels, each of which was compiled before."""
    kernels, _ = launches(work)
    assert kernels
    assert all(kernel["cache_hit"] for kernel in kernels)


@contextmanager
def own_cache(tmp_path_factory):
    """LLVM and a cache of its own, as in a test: for what is rendered once for a module."""
    select_variant("llvm_ad_rgb")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(paths, "_synchronize", lambda path: None)
        yield


def install_scene(patch, name, plugin):
    """Let `plugin` be the only installed scene."""
    names, load = registry.list_plugins, registry.load_plugin
    patch.setattr(registry, "list_plugins", lambda g: [name] if g == "scenes" else names(g))
    patch.setattr(registry, "load_plugin", lambda g, n: plugin if g == "scenes" else load(g, n))
