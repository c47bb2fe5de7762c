"""Intel's library: images, threads, errors; `oidn` and `oidn/fast` with its weights equal it."""

from __future__ import annotations

import re
import sys
from functools import cache

import pytest
import torch
from torch import Tensor

from baselines.oidn import method as oidn
from baselines.oidn_intel import FAMILY, TRAITS, extract
from baselines.oidn_intel.method import Filter, FilterSettings, LibraryError, build
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.fireflies import mean_without_fireflies
from rlbench.run import FrameResult, run_clip
from rlbench.system import provenance
from rlbench.weights import card_path
from tests.baselines.test_tza import float32_library

pytestmark = pytest.mark.skipif(
    bool(provenance.missing_packages(["pyoidn"])), reason="the extra oidn is not installed"
)
SIZE = Size(1, 96, 128)
CPU = torch.device("cpu")
# Relative, in radiance. Both compute in float32 and add in another order; the largest difference
# measured on such images is 9e-6. No padding: the sides are multiples of 16.
TOLERANCE = 1e-4


@cache
def denoise(variant: str) -> FrameResult:
    (result,) = run_clip(build(variant, CPU, None), procedural_clip(3, SIZE, 1), 2.0)
    return result


@pytest.mark.parametrize("variant", FAMILY.variants)
def test_most_of_the_noise_is_removed(variant):
    result = denoise(variant)
    reference = result.frame.reference.mean.clamp(0, 1)
    denoised, noisy = (
        (image.clamp(0, 1) - reference).square().mean()
        for image in (result.image, result.samples.mean)
    )
    assert denoised < 0.25 * noisy


@pytest.mark.parametrize("variant", ["fast", "clean"])
def test_other_settings_give_other_images(variant):
    difference = (denoise(variant).image - denoise("").image).abs().mean()
    assert difference > 1e-4 * denoise("").image.mean()


def test_images_of_other_sizes_in_between_have_no_effect():
    method = build("", CPU, None)
    for size in (Size(1, 17, 40), Size(1, 1, 1), Size(2, 33, 20)):
        (other,) = run_clip(method, procedural_clip(5, size, frames=1), 2.0)
        assert other.image.shape == (size.n, 3, size.h, size.w)
    (again,) = run_clip(method, procedural_clip(3, SIZE, 1), 2.0)
    assert torch.equal(again.image, denoise("").image)


@pytest.mark.parametrize("threads", [1, 2])
def test_it_runs_on_the_given_number_of_threads(threads):
    cores = provenance.machine().cores
    run_filter = Filter(FilterSettings(), 16, 16, threads)
    assert run_filter._device.get_int("numThreads") == min(threads, cores)


def test_invalid_weights_are_rejected():
    with pytest.raises(LibraryError, match="Open Image Denoise: "):
        Filter(FilterSettings(weights=b"no weights at all"), 16, 16, threads=1)


def test_the_config_records_the_library_version():
    method = registry.load_method("oidn-intel")
    assert method.traits == TRAITS
    assert re.fullmatch(r"2\.\d+\.\d+", method.config.library_version)


def random_frame(h: int, w: int, spread: float) -> tuple[GBuffer, Samples]:
    """Log-normal radiance, uniform albedo and normals, without any structure to agree upon."""
    generator = torch.Generator().manual_seed(h + w)
    albedo, normal = torch.rand(2, 1, 3, h, w, generator=generator)
    radiance = (spread * torch.randn(1, 2, 3, h, w, generator=generator)).exp()
    counts = torch.full((1, 1, h, w), 2)
    return GBuffer({"albedo": albedo, "normal": 2 * normal - 1}), Samples(radiance, counts)


def largest_relative_difference(image: Tensor, expected: Tensor) -> float:
    assert expected.min() > 1e-3  # else a relative difference means nothing
    return float(((image - expected).abs() / expected).max())


@pytest.mark.parametrize(("variant", "quality"), [("", "high"), ("fast", "fast")])
@pytest.mark.parametrize("size", [(16, 16), (64, 96), (208, 160)])
@pytest.mark.parametrize("spread", [0.5, 2.0])
@float32_library
def test_the_image_is_the_librarys_on_random_input(variant, quality, size, spread):
    gbuffer, samples = random_frame(*size, spread)
    image, _ = oidn.build(variant, CPU, None).denoise(gbuffer, samples, None)
    library = build(variant, CPU, None)  # its variants have the same names
    assert library.config.quality == quality
    expected, _ = library.denoise(gbuffer, samples, None)
    assert largest_relative_difference(image, expected) < TOLERANCE
    noisy = mean_without_fireflies(samples.radiance, samples.counts)
    assert largest_relative_difference(noisy, expected) > 0.1  # the image was denoised


def test_other_networks_of_equal_size_in_the_library_are_rejected(monkeypatch):
    networks = extract.read_library_networks()[::-1]
    monkeypatch.setattr(extract, "read_library_networks", lambda: networks)
    extract.load_network.cache_clear()
    found, expected = extract.load_network(), oidn.published_network()[0]
    torch.testing.assert_close(found.state_dict(), expected.state_dict(), rtol=0, atol=0)


def test_the_command_makes_the_shipped_files(tmp_path, capsys):
    extract.main([str(tmp_path)])
    written = [line.rpartition("/")[2] for line in capsys.readouterr().out.split()]
    assert written == ["oidn.safetensors", "fast.safetensors"]
    for name in written:
        shipped = registry.shipped_weights("oidn").parent / name
        assert (tmp_path / name).read_bytes() == shipped.read_bytes()
        assert card_path(tmp_path / name).read_text() == card_path(shipped).read_text()


def test_the_command_without_the_library_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)  # as if it could not be imported
    extract.load_network.cache_clear()
    with pytest.raises(SystemExit, match="2"):
        extract.main([str(tmp_path)])
    assert "pip install pyoidn" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
