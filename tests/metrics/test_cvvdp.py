"""ColorVideoVDP: what is handed to its package, and how its scores order images."""

from __future__ import annotations

import importlib.metadata
import math

import pytest
import torch

from metrics import cvvdp as module
from metrics.cvvdp import CVVDP, FRAMES_PER_SECOND
from tests.metrics.deep_packages import import_or_skip

package = import_or_skip("pycvvdp")
SIZE = (3, 32, 40)


@pytest.fixture(scope="module")
def clip():
    """Four frames that brighten, and the same with noise, linear."""
    random = torch.Generator().manual_seed(0)
    reference = [torch.rand(1, *SIZE, generator=random) * (0.2 + 0.1 * t) for t in range(4)]
    return reference, [r * (1 + 0.3 * torch.randn(r.shape, generator=random)) for r in reference]


def compare(images, references):
    return [CVVDP.compare(i, r, r) for i, r in zip(images, references, strict=True)]


def test_equal_clips_have_ten_jod_and_more_noise_has_less(clip):
    reference, noisy = clip
    noisier = [r + 3 * (n - r) for r, n in zip(reference, noisy, strict=True)]
    scores = [CVVDP.score(compare(images, reference)) for images in (reference, noisy, noisier)]
    assert scores[0] == 10
    assert 10 > scores[1] > scores[2]


def test_the_score_is_that_of_the_package_for_frames_in_eight_bits(clip):
    reference, noisy = clip
    videos = [
        torch.cat([getattr(c, name) for c in compare(noisy, reference)]).movedim(1, -1)
        for name in ("display_image", "display_reference")
    ]
    in_bytes = [(video * 255).round().to(torch.uint8).numpy() for video in videos]
    own = package.cvvdp(display_name="standard_4k", device=torch.device("cpu"), quiet=True)
    expected, _ = own.predict(*in_bytes, dim_order="FHWC", frames_per_second=FRAMES_PER_SECOND)
    # rounding to 8 bits is far below visible
    assert CVVDP.score(compare(noisy, reference)) == pytest.approx(float(expected), abs=0.02)


def test_a_clip_of_one_frame_and_a_pixel_that_is_not_finite_have_a_score(clip):
    reference, noisy = clip
    broken = reference[0].clone()
    broken[0, 1, 4, 4] = math.nan
    assert 0 < CVVDP.score(compare(noisy[:1], reference[:1])) < 10
    assert math.isfinite(CVVDP.score(compare([broken], reference[:1])))


def test_the_convention_names_version_display_and_frame_rate():
    convention = CVVDP.at(*SIZE[1:]).convention
    assert convention.startswith(f"cvvdp {importlib.metadata.version('cvvdp')}; ColorVideoVDP")
    assert convention.endswith(f"display {module.DISPLAY}, 24 frames per second")
