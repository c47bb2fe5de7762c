"""Finding libLLVM and selecting a variant."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rlbench.render.mitsuba import llvm

NINETEEN = llvm.LlvmLibrary(Path("/usr/lib/libLLVM.so.19.1"), 19)


@pytest.fixture
def false_library(tmp_path, monkeypatch):
    file = tmp_path / "libLLVM.so.19.1"
    file.write_bytes(b"not a library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(file))
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "cache"))
    return file


def test_a_file_that_is_not_a_library_is_unusable_with_a_reason(false_library):
    assert "LLVM" in llvm.probe_library(false_library)


def test_the_library_of_this_machine_is_usable(llvm):
    assert llvm == "llvm_ad_rgb"


def test_a_library_is_probed_once(false_library, tmp_path):
    reason = llvm.find_libraries()[0].unusable_reason
    note = tmp_path / "cache" / "llvm.json"
    note.write_text(note.read_text().replace(reason[:20], "as noted"))
    assert llvm.find_libraries()[0].unusable_reason.startswith("as noted")


def test_a_library_that_was_replaced_is_probed_again(false_library, tmp_path):
    reason = llvm.find_libraries()[0].unusable_reason
    note = tmp_path / "cache" / "llvm.json"
    note.write_text(note.read_text().replace(reason[:20], "as noted"))
    os.utime(false_library, ns=(1, 1))
    assert llvm.find_libraries()[0].unusable_reason == reason


def test_a_library_that_is_too_old_is_not_loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-15.so.1"))
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path))
    assert "too old" in llvm.find_libraries()[0].unusable_reason
    assert not (tmp_path / "llvm.json").exists()


def test_candidates_come_newest_first(tmp_path, monkeypatch):
    names = ("libLLVM-14.so.1", "libLLVM.so.19.1", "libLLVM-16.0.6.so", "libLLVM.so.22.1")
    for name in names:
        (tmp_path / name).touch()
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(llvm, "PATTERNS", (f"{tmp_path}/libLLVM*",))
    monkeypatch.setattr(llvm, "WHEEL", "no-such-wheel")
    assert [version for version, _ in llvm.find_candidates()] == [22, 19, 16, 14]


def test_the_library_of_the_wheel_is_found_wherever_pip_puts_it(tmp_path, monkeypatch):
    packages = tmp_path / "lib" / "python3.11" / "dist-packages"
    information = packages / "karellen_llvm_core-23.1.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Name: karellen-llvm-core\nVersion: 23.1\n")
    (information / "RECORD").write_text("../../libLLVM.so.23.1,,\n../../libLTO.so.23.1,,\n")
    (tmp_path / "lib" / "libLLVM.so.23.1").touch()
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(llvm, "PATTERNS", ())
    monkeypatch.setattr(sys, "path", [str(packages)])
    assert llvm.find_candidates() == [(23, tmp_path / "lib" / "libLLVM.so.23.1")]


def test_without_llvm_the_variant_is_scalar_with_a_hint_to_install_llvm(false_library):
    code = "from rlbench.render.mitsuba import llvm; print(llvm.select_variant())"
    run = [sys.executable, "-c", code]
    done = subprocess.run(run, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["scalar_rgb"]
    assert "apt-get install libllvm" in done.stderr


def test_the_report_says_what_cannot_be_used_and_what_to_install(false_library):
    text = llvm.describe_variant()
    assert f"cannot use {false_library}" in text
    assert "apt-get install libllvm" in text


def test_a_probe_sees_no_kernel_that_another_llvm_compiled(tmp_path, monkeypatch):
    (tmp_path / "kernel.bin").touch()
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path))
    code = "import os; assert not os.listdir(os.environ['DRJIT_CACHE_DIR']); print('usable')"
    monkeypatch.setattr(llvm, "PROBE", code)
    assert llvm.probe_library(tmp_path / "libLLVM.so.19.1") == ""


def test_each_version_of_llvm_has_kernels_of_its_own():
    others = [llvm.LlvmLibrary(NINETEEN.path, 20), None]
    assert len({llvm.kernel_cache(library) for library in (NINETEEN, *others)}) == 3


def test_dr_jit_keeps_its_kernels_there(llvm, tmp_path, monkeypatch):
    monkeypatch.delenv("DRJIT_CACHE_DIR", raising=False)
    code = (
        "from rlbench.render.mitsuba.llvm import find_libraries, kernel_cache, select_variant\n"
        "import os\n"
        "select_variant('llvm_ad_rgb')\n"
        "import drjit as dr, mitsuba as mi\n"
        "dr.eval(dr.opaque(mi.Float, 2.0, 100) ** 3.7)\n"
        "print(kernel_cache(next(l for l in find_libraries() if not l.unusable_reason)))\n"
    )
    run = [sys.executable, "-c", code]
    done = subprocess.run(run, capture_output=True, text=True, check=True, timeout=120)
    assert list(Path(done.stdout.strip()).glob("*.bin*"))


@pytest.mark.parametrize(
    ("library", "cuda_reason", "variant"),
    [
        (NINETEEN, "", "cuda_ad_rgb"),
        (None, "", "cuda_ad_rgb"),
        (NINETEEN, "no OptiX", "llvm_ad_rgb"),
        (NINETEEN, None, "llvm_ad_rgb"),
        (None, "no OptiX", "scalar_rgb"),
        (None, None, "scalar_rgb"),
    ],
)
def test_the_fastest_variant_that_works_is_chosen(library, cuda_reason, variant):
    assert llvm.fastest_variant(library, cuda_reason) == variant


def test_an_unknown_variant_is_an_error_that_lists_the_available_ones(llvm):
    from rlbench.render.mitsuba.llvm import select_variant

    with pytest.raises(ValueError, match="no variant 'metal_rgb'; available: .*scalar_rgb"):
        select_variant("metal_rgb")


def test_a_library_that_needs_a_missing_one_says_which(tmp_path, monkeypatch):
    """The wheel's library needs libatomic, which a bare container lacks."""
    libraries = [path.resolve() for path in llvm.wheel_files()]
    if not libraries:
        pytest.skip(f"the wheel {llvm.WHEEL} is not installed")
    alone = tmp_path / libraries[0].name  # away from the libc++ that lies beside it
    shutil.copy(libraries[0], alone)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(alone))
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "empty"))
    (library,) = llvm.find_libraries()
    assert "libc++.so.1: cannot open shared object file" in library.unusable_reason
    assert not (tmp_path / "empty" / "llvm.json").exists()  # probed again once it is installed


def test_no_first_call_loads_dr_jit_before_its_library_is_chosen():
    script = """
import sys
from rlbench.render.mitsuba import llvm
from rlbench.render.mitsuba.open_tracer import describe_tracer

configure = llvm._configure_drjit
def check(library):
    assert "drjit" not in sys.modules
    configure(library)
llvm._configure_drjit = check
print(describe_tracer())
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "_rgb" in done.stdout
