"""Finding libLLVM and an NVIDIA device, and selecting a variant; the tests need no device."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from rlbench.apps.render.mitsuba import variant
from rlbench.apps.render.mitsuba.variant import LlvmLibrary
from rlbench.system import paths

IMPORT = "from rlbench.apps.render.mitsuba import variant"
NINETEEN = LlvmLibrary(Path("/usr/lib/libLLVM.so.19.1"), 19)


def run_python(code):
    """A process that runs code, with this one's variables."""
    run = [sys.executable, "-c", code]
    return subprocess.run(run, capture_output=True, text=True, check=True, timeout=120)


@pytest.fixture
def false_library(tmp_path, monkeypatch):
    file = tmp_path / "libLLVM.so.19.1"
    file.write_bytes(b"not a library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(file))
    return file


def test_a_file_that_is_no_library_is_in_the_report_with_what_to_install(false_library):
    text = variant.describe_variant()
    assert f"cannot use {false_library}: " in text
    assert "apt-get install libllvm" in text


def test_a_library_that_is_too_old_is_not_loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-15.so.1"))
    assert "too old" in variant.find_libraries()[0].fault


def test_the_newest_comes_first_and_the_wheel_before_all(tmp_path, monkeypatch):
    for name in ("libLLVM-14.so.1", "libLLVM.so.19.1", "libLLVM-16.0.6.so", "libLLVM.so.22.1"):
        (tmp_path / name).touch()
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(variant, "PATTERNS", (f"{tmp_path}/libLLVM*",))
    monkeypatch.setattr(variant, "wheel_files", lambda: [tmp_path / "libLLVM.so.19.1"])
    assert [library.version for library in variant.find_libraries()] == [19, 22, 16, 14]


def test_the_library_of_the_wheel_is_found_wherever_pip_puts_it(tmp_path, monkeypatch):
    packages = tmp_path / "lib" / "python3.11" / "dist-packages"
    information = packages / "karellen_llvm_core-23.1.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Name: karellen-llvm-core\nVersion: 23.1\n")
    (information / "RECORD").write_text("../../libLLVM.so.23.1,,\n../../libLTO.so.23.1,,\n")
    (tmp_path / "lib" / "libLLVM.so.23.1").touch()
    monkeypatch.setattr(sys, "path", [str(packages)])
    (found,) = variant.wheel_files()
    assert found.resolve() == tmp_path / "lib" / "libLLVM.so.23.1"


def test_without_llvm_the_variant_is_scalar_with_a_hint_to_install_llvm(false_library):
    done = run_python(f"{IMPORT}; print(variant.select_variant())")
    assert done.stdout.split() == ["scalar_rgb"]
    assert "apt-get install libllvm" in done.stderr


def test_each_version_of_llvm_has_kernels_of_its_own():
    others = [LlvmLibrary(NINETEEN.path, 20), None]
    assert len({variant.kernel_cache(library) for library in (NINETEEN, *others)}) == 3


CODE = """
import sys
from rlbench.apps.render.mitsuba.open_tracer import describe_tracer

configure = variant._configure_drjit
def check(library):
    assert "drjit" not in sys.modules
    configure(library)
    print(variant.kernel_cache(library))
variant._configure_drjit = check
describe_tracer()
import drjit as dr, mitsuba as mi
dr.eval(dr.opaque(mi.Float, 2.0, 100) ** 3.7)
"""


def test_dr_jit_is_loaded_after_its_library_is_chosen_and_keeps_its_kernels_there(
    llvm, monkeypatch
):
    monkeypatch.delenv("DRJIT_CACHE_DIR", raising=False)
    done = run_python(f"{IMPORT}\n{CODE}")
    assert list(Path(done.stdout.strip()).glob("*.bin*"))


@pytest.mark.parametrize(
    ("library", "cuda", "expected"),
    [
        (NINETEEN, "", "cuda_ad_rgb"),
        (None, "", "cuda_ad_rgb"),
        (NINETEEN, "no OptiX", "llvm_ad_rgb"),
        (NINETEEN, None, "llvm_ad_rgb"),
        (None, "no OptiX", "scalar_rgb"),
        (None, None, "scalar_rgb"),
    ],
)
def test_the_fastest_variant_that_works_is_chosen(library, cuda, expected):
    assert variant.fastest_variant(library, cuda) == expected


@pytest.fixture
def false_driver(tmp_path, monkeypatch):
    if variant.find_cuda_driver():
        pytest.skip("an NVIDIA driver is installed, which a false one would not replace")
    file = tmp_path / "libcuda.so.1"
    file.write_bytes(b"not a library")
    monkeypatch.setattr(variant, "CUDA_DRIVERS", (str(file),))
    return file


def test_an_unusable_driver_is_in_the_report_and_tried_once(false_driver):
    fault = variant.cuda_fault()
    assert fault
    report = variant.describe_variant()
    assert f"cannot use cuda_ad_rgb with {false_driver}: {fault}" in report
    assert not report.startswith("path tracer: cuda")
    note = paths.cache_folder() / "cuda.json"
    note.write_text(note.read_text().replace(f'"{fault}"', '""'))
    assert variant.describe_variant().startswith(f"path tracer: cuda_ad_rgb, with {false_driver}")


def test_the_probe_passes_where_rays_can_be_traced(llvm):
    assert variant._run_probe(variant.CUDA_PROBE.replace("cuda_ad_rgb", llvm)) == ""
