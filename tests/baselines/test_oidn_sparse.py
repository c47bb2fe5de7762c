"""Sparse samples before OIDN: filled holes and joint upsampling, against loops and closed forms."""

from __future__ import annotations

from itertools import product

import pytest
import torch

from baselines.oidn.method import Oidn
from baselines.oidn.sparse import (
    EDGE_FALLOFF,
    FAR,
    MIN_SIMILARITY,
    NEAR,
    FilledHoles,
    HalfResolution,
    upsample_jointly,
)
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.ops.accumulation import feature_similarity
from rlbench.run import run_clip
from tests.baselines.noise import one_sample, random_tensor, wall


class Identity:
    """A denoiser that shows the mean of its samples."""

    def denoise(self, gbuffer, samples, state):
        return samples.mean, state


def test_joint_upsampling_equals_a_loop():
    h, w = 7, 10
    image, coarse, fine = (
        random_tensor(1, 2, 4, 5),
        random_tensor(1, 7, 4, 5, seed=1),
        random_tensor(1, 7, h, w, seed=2),
    )
    expected = torch.zeros(1, 2, h, w)
    for y, x in product(range(h), range(w)):
        total, weights = torch.zeros(2), 0.0
        for (row, of_row), (column, of_column) in product(taps(y, 4), taps(x, 5)):
            similar = feature_similarity(
                fine[..., y : y + 1, x : x + 1],
                coarse[..., row : row + 1, column : column + 1],
                EDGE_FALLOFF,
            )
            weight = of_row * of_column * (float(similar) + MIN_SIMILARITY)
            total, weights = total + weight * image[0, :, row, column], weights + weight
        expected[0, :, y, x] = total / weights
    torch.testing.assert_close(upsample_jointly(image, coarse, fine), expected)


def taps(index: int, count: int) -> list[tuple[int, float]]:
    """The coarse pixels whose centres lie around that of a fine pixel."""
    centre = (index + 0.5) / 2 - 0.5
    below = int(centre // 1)
    near_below = centre - below < 0.5
    pairs = [(below, NEAR if near_below else FAR), (below + 1, FAR if near_below else NEAR)]
    return [(min(max(tap, 0), count - 1), weight) for tap, weight in pairs]


@pytest.mark.parametrize("wrapper", [FilledHoles, HalfResolution])
def test_constant_light_on_a_texture_is_exact_from_half_of_the_samples(wrapper):
    """Radiance in proportion to albedo + 0.01, the factor of demodulation, in odd sizes."""
    albedo = random_tensor(1, 3, 33, 47).clamp_min(0.05)
    truth = 2.0 * (albedo + 0.01)
    method = wrapper(Identity(), Oidn.traits)
    counts = (random_tensor(1, 1, 33, 47, seed=1) < 0.5).long()
    sparse = Samples((truth * counts)[:, None], counts)
    image, _ = method.denoise(wall(33, 47, albedo=albedo), sparse, None)
    if wrapper is FilledHoles:
        torch.testing.assert_close(image, truth, rtol=1e-4, atol=1e-5)
    else:  # a coarse pixel has the mean texture of four, but samples of some of them only
        light = image / (albedo + 0.01)
        assert abs(float(light.mean()) - 2.0) < 0.1


def test_light_does_not_leak_over_the_edge_of_a_surface():
    gbuffer = wall(16, 16)
    gbuffer.buffers["normal"][..., 8:] = torch.tensor([1.0, 0.0, 0.0]).view(1, 3, 1, 1)
    radiance = torch.ones(1, 3, 16, 16)
    radiance[..., 8:] = 0.0
    half = HalfResolution(Identity(), Oidn.traits)
    image, _ = half.denoise(gbuffer, one_sample(radiance), None)
    torch.testing.assert_close(image, radiance, rtol=0.02, atol=0.02)  # e^-4 is the similarity


@pytest.mark.parametrize("name", ["oidn/filled", "oidn/half", "oidn-intel/filled"])
def test_below_one_sample_the_image_is_far_better_than_with_black_holes(name):
    if name.startswith("oidn-intel"):
        pytest.importorskip("pyoidn")
    clip = procedural_clip(11, Size(1, 48, 64), 1)
    truth = clip.frames[0].reference.mean
    black_holes = registry.load_method("oidn/tuned")
    (result,) = run_clip(registry.load_method(name), clip, 0.25)
    (full,) = run_clip(registry.load_method("mean"), clip, 0.25)
    image, _ = black_holes.denoise(clip.frames[0].gbuffer, full.samples, None)
    pair = (result.image, image)
    errors = [(x.clamp(0, 1) - truth.clamp(0, 1)).square().mean() for x in pair]
    assert errors[0] < errors[1] / 4
