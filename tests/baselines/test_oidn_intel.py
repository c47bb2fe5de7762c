"""oidn-intel: Intel's library denoises, on as many threads as torch, and says what fails."""

from __future__ import annotations

import re
import subprocess
import sys
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
def shown(variant: str) -> FrameResult:
    from baselines.oidn_intel.method import build

    (only,) = run_clip(build(variant, CPU, None), clip(), 2.0)
    return only


def error(image: torch.Tensor, reference: torch.Tensor) -> float:
    """Squared, of what a display shows."""
    return float((image.clamp(0, 1) - reference.clamp(0, 1)).square().mean())


def test_listing_it_imports_neither_torch_nor_the_library():
    code = (
        "import sys, baselines.oidn_intel; sys.exit(bool({'torch', 'pyoidn'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@installed
def test_every_row_of_the_family_can_be_built():
    from baselines.oidn_intel.method import VARIANTS

    assert set(FAMILY.variants) == set(VARIANTS)


@installed
@pytest.mark.parametrize("variant", FAMILY.variants)
def test_most_of_the_noise_goes(variant):
    frame = shown(variant)
    truth, noisy = frame.frame.reference.mean, frame.samples.mean
    assert error(frame.image, truth) < 0.25 * error(noisy, truth)


@installed
@pytest.mark.parametrize("variant", ["fast", "clean"])
def test_other_networks_give_other_images(variant):
    difference = (shown(variant).image - shown("").image).abs().mean()
    assert difference > 1e-4 * shown("").image.mean()


@installed
def test_the_image_scales_with_the_light():
    from baselines.oidn_intel.method import build

    frame = shown("")
    brighter = Samples(frame.samples.radiance * 128, frame.samples.counts)
    image, _ = build("", CPU, None).denoise(frame.frame.gbuffer, brighter, None)
    # exposure in float32, then a logarithm and an exponential with 16 nats between 0 and 1
    torch.testing.assert_close(image / 128, frame.image, rtol=2e-3, atol=1e-5)


@installed
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1.0, 0.0])
def test_bad_radiance_gives_a_finite_image(bad):
    from baselines.oidn_intel.method import build

    samples = Samples(torch.full((1, 8, 3, 96, 128), bad), torch.full((1, 1, 96, 128), 8))
    image, _ = build("", CPU, None).denoise(shown("").frame.gbuffer, samples, None)
    assert torch.isfinite(image).all()


@installed
def test_images_of_other_sizes_in_between_change_nothing():
    from baselines.oidn_intel.method import build

    made = build("", CPU, None)
    for size in (Size(1, 17, 40), Size(1, 1, 1), Size(2, 33, 20)):
        (other,) = run_clip(made, procedural_clip(5, size, frames=1), 2.0)
        assert other.image.shape == (size.n, 3, size.h, size.w)
    (again,) = run_clip(made, clip(), 2.0)
    assert torch.equal(again.image, shown("").image)


@installed
@pytest.mark.parametrize("threads", [1, 2])
def test_it_runs_on_as_many_threads_as_it_is_told(threads):
    from baselines.oidn_intel.library import Filter, Settings

    allowed = provenance.machine().cores
    run = Filter(Settings(), 16, 16, threads)
    assert run._device.get_int("numThreads") == min(threads, allowed)


@installed
def test_weights_that_are_none_are_refused():
    from baselines.oidn_intel.library import Filter, LibraryError, Settings

    with pytest.raises(LibraryError, match="Open Image Denoise: "):
        Filter(Settings(weights=b"no weights at all"), 16, 16, threads=1)


@installed
def test_its_rows_say_which_version_made_them():
    method = registry.load_method("oidn-intel")
    assert method.traits == TRAITS
    assert re.fullmatch(r"2\.\d+\.\d+", method.config.library)
