"""IMCD: its filter against loops, its history, and its training."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.imcd.method import Config, Imcd, build
from baselines.imcd.network import (
    EMBEDDING,
    Encoder,
    Kernels,
    KernelSizes,
    PreviousFrame,
    apply_affinity_kernels,
)
from baselines.imcd.train import losses, sharpness_penalty, training_task
from rlbench.frames import GBuffer
from rlbench.run import run_clip
from tests.baselines.noise import SMALL, noisy_clip, random_tensor, read_samples

CPU = torch.device("cpu")
SMALL_KERNELS = KernelSizes(spatial=5, temporal=3)


def kernels(h: int, w: int) -> Kernels:
    return Kernels(
        features=random_tensor(1, 3, 8, h, w, seed=5),
        sharpness=3 * random_tensor(1, 3, 1, h, w, seed=6),
        centre_weight=random_tensor(1, 3, 1, h, w, seed=7),
        temporal_sharpness=3 * random_tensor(1, 1, h, w, seed=8),
        history_weight=torch.zeros(1, 1, h, w),
    )


@pytest.fixture(scope="module")
def method() -> Imcd:
    return replace(build("", CPU, "random"), config=Config(SMALL_KERNELS))


@pytest.fixture(scope="module")
def trainable() -> Imcd:
    """IMCD with trainable weights and small kernels, for speed."""
    return replace(training_task("", CPU, seed=0).method, config=Config(SMALL_KERNELS))


def filter_in_loops(
    irradiance: Tensor,
    predicted: Kernels,
    previous: PreviousFrame | None,
    kernel_sizes: KernelSizes,
) -> np.ndarray:
    """Eq. 4, 6, 7 and 8, one pixel and one neighbour at a time, [3 h w] in float64."""
    _, _, h, w = irradiance.shape
    image = irradiance[0].double().numpy()
    features, sharpness, centre = (part[0].double().numpy() for part in predicted[:3])
    for k, dilation in enumerate((1, 2, 4)):
        before, image = image, np.zeros_like(image)
        for y, x in np.ndindex(h, w):
            total, weights = np.zeros(3), 1e-10
            for v, u in _window(kernel_sizes.spatial, y, x, dilation, h, w):
                distance = ((features[k, :, y, x] - features[k, :, v, u]) ** 2).sum()
                weight = np.exp(-sharpness[k, 0, y, x] * distance)
                weight = centre[k, 0, y, x] if (v, u) == (y, x) else weight
                total, weights = total + weight * before[:, v, u], weights + weight
            if previous is not None and k == 2:
                remembered, old = (part[0].double().numpy() for part in previous[:2])
                for v, u in _window(kernel_sizes.temporal, y, x, 1, h, w):
                    distance = ((features[2, :, y, x] - remembered[:, v, u]) ** 2).sum()
                    weight = np.exp(-float(predicted.temporal_sharpness[0, 0, y, x]) * distance)
                    weight *= float(previous.weight[0, 0, v, u])
                    total, weights = total + weight * old[:, v, u], weights + weight
            image[:, y, x] = total / weights
    return image


def _window(side: int, y: int, x: int, dilation: int, h: int, w: int) -> list[tuple[int, int]]:
    steps = range(-(side // 2), side // 2 + 1)
    reached = ((y + i * dilation, x + j * dilation) for i in steps for j in steps)
    return [(v, u) for v, u in reached if 0 <= v < h and 0 <= u < w]


@pytest.mark.parametrize("has_history", [True, False])
def test_the_filter_equals_plain_loops(has_history: bool) -> None:
    irradiance, predicted = random_tensor(1, 3, 12, 12), kernels(12, 12)
    weight = (random_tensor(1, 1, 12, 12, seed=9) - 0.3).clamp_min(0)  # 0 for three in ten
    previous = PreviousFrame(
        random_tensor(1, 8, 12, 12, seed=10), random_tensor(1, 3, 12, 12, seed=11), weight
    )
    previous = previous if has_history else None
    expected = filter_in_loops(irradiance, predicted, previous, SMALL_KERNELS)
    filtered = apply_affinity_kernels(irradiance, predicted, previous, SMALL_KERNELS)
    np.testing.assert_allclose(filtered[0].numpy(), expected, rtol=1e-5)  # float32, 34 terms


def test_the_mean_embedding_is_that_of_valid_slots() -> None:
    encoder = Encoder()
    colours, gbuffer = random_tensor(2, 8, 3, 6, 7), random_tensor(2, 7, 6, 7, seed=1)
    valid = torch.arange(8).view(1, 8, 1, 1, 1) < 1 + torch.arange(7)
    valid = valid.expand(2, 8, 1, 6, 7)
    samples = torch.cat((colours, gbuffer[:, None].expand(-1, 8, -1, -1, -1)), 2)
    each = encoder.embed(samples.flatten(0, 1)).unflatten(0, (2, 8))
    expected = (each * valid).sum(1) / valid.sum(1)
    # float32 sums of eight
    torch.testing.assert_close(encoder(colours, gbuffer, valid), expected, rtol=1e-5, atol=1e-6)


def test_a_repeated_frame_keeps_its_features_and_is_blended_with_the_first(method: Imcd) -> None:
    frame = noisy_clip().frames[0]
    still, samples = replace(frame.gbuffer, static=True), read_samples(frame)
    _, first = method.denoise(still, samples, method.start(SMALL))
    _, second, predicted = method.denoise_with_kernels(still, samples, first)
    assert torch.equal(first.irradiance, second.irradiance)
    assert torch.equal(first.features, second.features)
    remembered, weight = first.features[:, EMBEDDING:], torch.ones(1, 1, 16, 16)
    previous = PreviousFrame(remembered, first.denoised, weight)
    sizes = method.config.kernel_sizes
    expected = apply_affinity_kernels(first.irradiance, predicted, previous, sizes)
    assert torch.equal(second.denoised, expected)
    assert not torch.equal(second.denoised, first.denoised)


def test_emitters_with_black_albedo_keep_their_radiance(method: Imcd) -> None:
    """Dividing by 0.01 would make them a hundred times as bright as their neighbours."""
    frame = noisy_clip().frames[0]
    black = GBuffer({**frame.gbuffer.buffers, "albedo": torch.zeros(1, 3, 16, 16)})
    samples = read_samples(frame)
    _, state = method.denoise(black, samples, method.start(SMALL))
    # float32 sums of 8
    torch.testing.assert_close(state.irradiance, samples.mean / 1.01, rtol=1e-5, atol=0)


def test_the_sharpness_penalty_is_the_mean_of_squares() -> None:
    two, three = torch.full((1, 3, 1, 4, 4), 2.0), torch.full((1, 1, 4, 4), 3.0)
    predicted = kernels(4, 4)._replace(sharpness=two, temporal_sharpness=three)
    assert float(sharpness_penalty(predicted)) == pytest.approx(2.0**2 + 3.0**2)


def test_the_loss_is_smape_of_images_plus_a_quarter_of_the_smape_of_changes(
    trainable: Imcd,
) -> None:
    clip = noisy_clip(2)
    (loss,) = losses(trainable, clip, 2.0)
    images = [result.image.double().numpy() for result in run_clip(trainable, clip, 2.0)]
    references = [frame.reference.mean.double().numpy() for frame in clip]
    spatial = np.mean([_smape(*pair) for pair in zip(images, references, strict=True)])
    temporal = _smape(images[1] - images[0], references[1] - references[0])
    # the first of the two frames has no change; 1e-5 (a^2 + b^2) is below 1e-3 at the start
    assert float(loss.detach()) == pytest.approx(spatial + 0.25 * temporal / 2, abs=1e-3)


def _smape(image: np.ndarray, reference: np.ndarray) -> float:
    return float((abs(image - reference) / (abs(image) + abs(reference) + 0.01)).mean())


MEMORY = """
import resource, torch
torch.set_num_threads(1)
from baselines.imcd.method import build
from rlbench.frames import Size
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.run import run_clip

peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
method = build("", torch.device("cpu"), "random")
list(run_clip(method, procedural_clip(0, Size(1, 32, 32), frames=2), 8.0))
before = peak()
for _ in run_clip(method, procedural_clip(0, Size(1, 720, 720), frames=2), 8.0):
    pass
print(peak() - before)  # KiB
"""


@pytest.mark.slow
def test_two_frames_of_720x720_at_8_spp_take_less_than_2_gb() -> None:
    """Growth of the process, including about 0.5 GB of samples, G-buffers and references."""
    process = subprocess.run(
        [sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True
    )
    assert int(process.stdout) * 1024 < 2e9
