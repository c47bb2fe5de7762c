"""oidn-intel: Intel's library denoises, uses the given threads, and reports its errors."""

from __future__ import annotations

import re
from functools import cache

import pytest
import torch

from baselines.oidn_intel import FAMILY, TRAITS
from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.run import FrameResult, run_clip
from rlbench.system import provenance

installed = pytest.mark.skipif(
    bool(provenance.missing_packages(["pyoidn"])), reason="the extra oidn is not installed"
)
SIZE = Size(1, 96, 128)
CPU = torch.device("cpu")


def clip() -> InMemoryClip:
    return procedural_clip(3, SIZE, frames=1)


@cache
def denoise(variant: str) -> FrameResult:
    from baselines.oidn_intel.method import build

    (result,) = run_clip(build(variant, CPU, None), clip(), 2.0)
    return result


def error(image: torch.Tensor, reference: torch.Tensor) -> float:
    """Mean squared error of values clipped to the display range."""
    return float((image.clamp(0, 1) - reference.clamp(0, 1)).square().mean())


@installed
@pytest.mark.parametrize("variant", FAMILY.variants)
def test_most_of_the_noise_is_removed(variant):
    result = denoise(variant)
    reference, noisy = result.frame.reference.mean, result.samples.mean
    assert error(result.image, reference) < 0.25 * error(noisy, reference)


@installed
@pytest.mark.parametrize("variant", ["fast", "clean"])
def test_other_settings_give_other_images(variant):
    difference = (denoise(variant).image - denoise("").image).abs().mean()
    assert difference > 1e-4 * denoise("").image.mean()


@installed
def test_the_image_scales_with_the_radiance():
    from baselines.oidn_intel.method import build

    result = denoise("")
    brighter = Samples(result.samples.radiance * 128, result.samples.counts)
    image, _ = build("", CPU, None).denoise(result.frame.gbuffer, brighter, None)
    # exposure in float32, then a logarithm and an exponential with 16 nats between 0 and 1
    torch.testing.assert_close(image / 128, result.image, rtol=2e-3, atol=1e-5)


@installed
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1.0, 0.0])
def test_invalid_radiance_gives_a_finite_image(bad):
    from baselines.oidn_intel.method import build

    samples = Samples(torch.full((1, 8, 3, 96, 128), bad), torch.full((1, 1, 96, 128), 8))
    image, _ = build("", CPU, None).denoise(denoise("").frame.gbuffer, samples, None)
    assert torch.isfinite(image).all()


@installed
def test_images_of_other_sizes_in_between_have_no_effect():
    from baselines.oidn_intel.method import build

    method = build("", CPU, None)
    for size in (Size(1, 17, 40), Size(1, 1, 1), Size(2, 33, 20)):
        (other,) = run_clip(method, procedural_clip(5, size, frames=1), 2.0)
        assert other.image.shape == (size.n, 3, size.h, size.w)
    (again,) = run_clip(method, clip(), 2.0)
    assert torch.equal(again.image, denoise("").image)


@installed
@pytest.mark.parametrize("threads", [1, 2])
def test_it_runs_on_the_given_number_of_threads(threads):
    from baselines.oidn_intel.method import Filter, FilterSettings

    cores = provenance.machine().cores
    run_filter = Filter(FilterSettings(), 16, 16, threads)
    assert run_filter._device.get_int("numThreads") == min(threads, cores)


@installed
def test_invalid_weights_are_rejected():
    from baselines.oidn_intel.method import Filter, FilterSettings, LibraryError

    with pytest.raises(LibraryError, match="Open Image Denoise: "):
        Filter(FilterSettings(weights=b"no weights at all"), 16, 16, threads=1)


@installed
def test_the_config_records_the_library_version():
    method = registry.load_method("oidn-intel")
    assert method.traits == TRAITS
    assert re.fullmatch(r"2\.\d+\.\d+", method.config.library_version)
