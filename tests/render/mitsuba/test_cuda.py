"""Finding a usable NVIDIA device; the tests need none."""

import pytest

from rlbench.render.mitsuba import cuda, llvm, probe


@pytest.fixture
def false_driver(tmp_path, monkeypatch):
    if cuda.find_driver():
        pytest.skip("an NVIDIA driver is installed, which a false one would not replace")
    file = tmp_path / "libcuda.so.1"
    file.write_bytes(b"not a library")
    monkeypatch.setattr(cuda, "DRIVERS", (str(file),))
    return file


def test_without_a_driver_there_is_no_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(cuda, "DRIVERS", (f"{tmp_path}/libcuda.so.1",))
    assert cuda.unusable_reason() is None
    assert not list(tmp_path.rglob("cuda.json"))


def test_an_unusable_driver_is_in_the_report_with_the_reason(false_driver):
    assert cuda.unusable_reason()
    assert (
        f"cannot use cuda_ad_rgb with {false_driver}: {cuda.unusable_reason()}"
        in llvm.describe_variant()
    )
    assert not llvm.describe_variant().startswith("path tracer: cuda")


def test_a_driver_is_probed_once(false_driver, tmp_path):
    reason = cuda.unusable_reason()
    note = next(tmp_path.rglob("cuda.json"))
    note.write_text(note.read_text().replace(reason[:10], "as noted"))
    assert cuda.unusable_reason().startswith("as noted")


def test_a_driver_that_works_is_used(false_driver, tmp_path):
    reason = cuda.unusable_reason()
    note = next(tmp_path.rglob("cuda.json"))
    note.write_text(note.read_text().replace(f'"{reason}"', '""'))
    assert llvm.describe_variant().startswith(f"path tracer: cuda_ad_rgb, with {false_driver}")


def test_the_probe_passes_where_rays_can_be_traced(llvm):
    assert probe.probe_subprocess(cuda.PROBE.replace("cuda_ad_rgb", llvm), {}) == ""
