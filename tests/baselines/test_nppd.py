"""NPPD: its filter against loops, conservation of light, its history, and its training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from baselines.accumulate.memory import LightHistory
from baselines.nppd.method import Nppd, build
from baselines.nppd.network import (
    Encoder,
    FilterWeights,
    Networks,
    WeightUNet,
    apply_partitioning_pyramid,
)
from baselines.nppd.train import FramePairs, losses, training_task
from rlbench.checks.frame_edits import to_clip
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Samples, Size
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.ops.fireflies import limit_fireflies
from rlbench.run import run_clip, unroll
from tests.baselines.noise import random_tensor, read_samples

CPU = torch.device("cpu")
SIZE = Size(1, 32, 32)
LAMBDA = 51  # channel of the finest head


def small_clip(frames: int = 2, size: Size = SIZE) -> InMemoryClip:
    return to_clip(procedural_clip(0, size, frames, 8))


def first_frame() -> tuple[Frame, Samples]:
    """A frame, and four samples in each of its pixels."""
    frame = small_clip(1).frames[0]
    return frame, read_samples(frame, 4)


def random_weights(h: int, w: int) -> FilterWeights:
    """Weights that vary strongly between pixels."""

    def softmax(taps: int, level: int, seed: int) -> Tensor:
        return (6 * random_tensor(1, taps, h >> level, w >> level, seed=seed)).softmax(1)

    return FilterWeights(
        softmax(5, 0, 1),
        tuple(softmax(25, i, 2 + i) for i in range(5)),
        tuple(4 * softmax(16, i, 7 + i) for i in range(1, 5)),
        softmax(25, 0, 12),
        torch.full((1, 1, h, w), 0.3),
        torch.full((1, 1, h, w), 0.5),
    )


def with_bias(channel: int, bias: float) -> Nppd:
    """The method with random weights, and one output of the finest level near a limit."""
    method = build("", CPU, "random")
    method.networks.unet.heads[0].bias.data[channel] = bias
    return method


def demodulate(frame: Frame, samples: Samples) -> Tensor:
    """The mean of limited samples without albedo."""
    albedo = demodulation_albedo(filtered_albedo(frame.gbuffer.albedo))
    return Samples(limit_fireflies(samples.radiance, samples.counts), samples.counts).mean / albedo


def constant_state(value: float) -> LightHistory:
    return LightHistory(*(torch.full((1, c, 32, 32), value) for c in (3, 3, 32)), age=1)


@pytest.fixture(scope="module")
def method() -> Nppd:
    return build("", CPU, "random")


@pytest.fixture(scope="module")
def trainable() -> Nppd:
    return training_task("", CPU, seed=0).method


def mirror(position: int, side: int) -> int:
    """The pixel inside the image that a pixel beyond its border is mirrored to."""
    if position < 0:
        return -1 - position
    return position if position < side else 2 * side - 1 - position


def splat_in_loops(image: np.ndarray, kernels: np.ndarray, stride: int) -> np.ndarray:
    """One pixel and one tap at a time, [3 h w]."""
    _, h, w = image.shape
    side = round(len(kernels) ** 0.5)
    reach = (side - stride) // 2
    total = np.zeros((3, stride * h, stride * w))
    for y, x, tap in np.ndindex(h, w, side * side):
        v = mirror(stride * y + tap // side - reach, stride * h)
        u = mirror(stride * x + tap % side - reach, stride * w)
        total[:, v, u] += kernels[tap, y, x] * image[:, y, x]
    return total


def filter_in_loops(irradiance: Tensor, previous: Tensor, weights: FilterWeights) -> np.ndarray:
    """The whole filter, in double precision, [3 h w]."""
    image, before = (light[0].double().numpy() for light in (irradiance, previous))
    partition = weights.partition[0].double().numpy()
    total: np.ndarray | None = None
    for i in reversed(range(5)):
        part, side = image * partition[i], 2**i
        _, h, w = part.shape
        tiles = part.reshape(3, h // side, side, w // side, side).mean((2, 4))
        level = splat_in_loops(tiles, weights.kernels[i][0].double().numpy(), 1)
        if total is not None:
            level += splat_in_loops(total, weights.upsampling[i][0].double().numpy(), 2)
        total = level
    history = splat_in_loops(before, weights.history_kernels[0].double().numpy(), 1)
    mu = weights.output_history_weight[0].double().numpy()
    assert total is not None
    return mu * history + (1 - mu) * total


def test_the_filter_equals_plain_loops() -> None:
    irradiance, previous = random_tensor(1, 3, 32, 48, seed=20), random_tensor(1, 3, 32, 48)
    inputs = irradiance, previous, random_weights(32, 48)
    filtered, expected = apply_partitioning_pyramid(*inputs), filter_in_loops(*inputs)
    # float32 sums of about a hundred terms
    np.testing.assert_allclose(filtered[0].numpy(), expected, rtol=1e-5)


def test_the_filter_neither_loses_nor_creates_light() -> None:
    irradiance, previous = random_tensor(1, 3, 64, 48, seed=20), random_tensor(1, 3, 64, 48)
    filtered = apply_partitioning_pyramid(irradiance, previous, random_weights(64, 48))
    expected = 0.7 * irradiance.double().sum((2, 3)) + 0.3 * previous.double().sum((2, 3))
    torch.testing.assert_close(filtered.double().sum((2, 3)), expected, rtol=1e-5, atol=0)


def test_the_u_net_equals_its_layers_written_out() -> None:
    widths = ((4, 5), (6, 7), (8, 9), (10, 11), (12, 13), (14, 15, 16))
    unet = WeightUNet(widths)
    image = random_tensor(1, 70, 32, 64)
    skips, x = [], image
    for level in range(6):
        x = F.max_pool2d(x, 2) if level else x
        for layer in list(unet.encoders[level])[::2]:
            x = F.leaky_relu(layer(x), 0.3)
        skips.append(x)
    for level in range(4, -1, -1):
        decoder, joined = unet.decoders[level], (F.interpolate(x, scale_factor=2), skips[level])
        join = F.conv2d(torch.cat(joined, 1), decoder.join.weight, decoder.join.bias, padding=1)
        assert join.shape[1] == widths[level][1]
        x = F.leaky_relu(decoder.rest[0](F.leaky_relu(join, 0.3)), 0.3)
        expected = unet.heads[level](x)
        torch.testing.assert_close(unet(image)[level], expected, rtol=1e-4, atol=1e-5)  # float32


def test_predicted_weights_are_a_partition_of_unity() -> None:
    networks = Networks()
    networks.init_weights(seed=0)
    for head in networks.unet.heads:
        head.weight.data.mul_(50.0)  # far from uniform
    weights = networks.predict_weights(random_tensor(1, 70, 32, 64))
    sums = [
        (weights.partition, 1.0),
        (weights.history_kernels, 1.0),
        *((kernels, 1.0) for kernels in weights.kernels),
        *((kernels, 4.0) for kernels in weights.upsampling),  # a pixel becomes four
    ]
    assert weights.partition.amax() > 0.5
    for values, expected in sums:
        assert values.min() >= 0
        torch.testing.assert_close(
            values.sum(1), torch.full_like(values[:, 0], expected), rtol=1e-5, atol=0
        )
    assert [tuple(k.shape[1:]) for k in weights.kernels] == [
        (25, 32 >> i, 64 >> i) for i in range(5)
    ]


@pytest.mark.parametrize(("bias", "expected"), [(-80.0, "frame"), (80.0, "history")])
def test_lambda_selects_the_light_of_history_or_frame(bias: float, expected: str) -> None:
    frame, samples = first_frame()
    static = replace(frame.gbuffer, static=True)
    _, state = with_bias(LAMBDA, bias).denoise(static, samples, constant_state(0.25))
    light = {"frame": demodulate(frame, samples), "history": torch.full((1, 3, 32, 32), 0.25)}
    # the first convolution of the network leaves the sigmoid at 0 or 1 up to rounding
    torch.testing.assert_close(state.irradiance, light[expected], rtol=1e-5, atol=1e-6)
    is_history = bool((state.features - 0.25).abs().max() < 1e-5)
    assert is_history == (expected == "history")


def test_the_mean_embedding_is_the_mean_of_the_embedded_samples() -> None:
    encoder = Encoder()
    colours, gbuffer = random_tensor(2, 8, 3, 6, 7), random_tensor(2, 7, 6, 7, seed=1)
    counts = 1 + torch.arange(7).remainder(4).expand(2, 1, 6, 7)
    valid = Samples(colours, counts).valid_mask
    samples = torch.cat((colours, gbuffer[:, None].expand(-1, 8, -1, -1, -1)), 2).flatten(0, 1)
    hidden = F.leaky_relu(encoder.second(F.leaky_relu(encoder.first(samples), 0.3)), 0.3)
    each = encoder.third(hidden).unflatten(0, (2, 8))
    expected = (each * valid).sum(1) / counts
    # float32 sums of up to four
    torch.testing.assert_close(encoder(colours, gbuffer, valid), expected, rtol=1e-5, atol=1e-6)


def test_a_pixel_without_a_sample_takes_its_history() -> None:
    frame, samples = first_frame()
    partial = read_samples(frame, samples.counts * (torch.arange(32) >= 16))
    static = replace(frame.gbuffer, static=True)
    _, state = with_bias(LAMBDA, -80.0).denoise(static, partial, constant_state(0.25))
    assert (state.irradiance[..., :16] - 0.25).abs().max() < 1e-5
    torch.testing.assert_close(
        state.irradiance[..., 16:], demodulate(frame, partial)[..., 16:], rtol=1e-4, atol=1e-6
    )


def test_a_pixel_without_sample_and_history_takes_its_neighbourhood(method: Nppd) -> None:
    gbuffer = first_frame()[0].gbuffer
    flat = GBuffer({**gbuffer.buffers, "albedo": torch.full((1, 3, 32, 32), 0.5)})
    counts = torch.ones(1, 1, 32, 32, dtype=torch.int64)
    counts[..., 8:12, 8:12] = 0
    samples = Samples(torch.full((1, 1, 3, 32, 32), 0.4) * (counts > 0)[:, None], counts)
    _, state = method.denoise(flat, samples, method.start(SIZE))
    torch.testing.assert_close(state.irradiance, torch.full_like(state.irradiance, 0.4 / 0.51))


def test_a_quarter_of_a_sample_per_pixel_keeps_the_brightness(method: Nppd) -> None:
    clip = small_clip(3, Size(1, 64, 64))
    for result in run_clip(method, clip, 0.25):
        ratio = float(result.image.mean() / result.frame.reference.mean.mean())
        assert 0.7 < ratio < 1.4  # 0.25 with holes left black


@pytest.mark.parametrize("part", ["irradiance", "denoised", "features"])
def test_a_later_frame_uses_every_part_of_the_state(method: Nppd, part: str) -> None:
    frame, samples = first_frame()
    static = replace(frame.gbuffer, static=True)
    state = constant_state(0.5)
    changed = state._replace(**{part: torch.full_like(getattr(state, part), 3.0)})
    first, second = (method.denoise(static, samples, s)[0] for s in (state, changed))
    assert not torch.allclose(first, second, rtol=1e-4)


def smape_in_numpy(image: np.ndarray, reference: np.ndarray) -> float:
    return float((abs(image - reference) / (abs(image) + abs(reference) + 1e-3)).mean())


def test_the_losses_are_those_of_the_release_without_features(trainable: Nppd) -> None:
    clip = small_clip(2)
    for frame in clip.frames:
        frame.gbuffer.motion.zero_()  # the previous image needs no warp
    first, second = (float(loss.detach()) for loss in losses(trainable, clip, 2.0))
    images = [result.image.double().numpy() for result in run_clip(trainable, clip, 2.0)]
    references = [frame.reference.mean.double().numpy() for frame in clip]
    scale = references[0].mean()
    assert first == pytest.approx(8 * smape_in_numpy(images[0] / scale, references[0] / scale))
    scale = np.mean(references)
    a, b = (image / scale for image in images)
    y, z = (reference / scale for reference in references)
    spatial = smape_in_numpy(np.stack((a, b)), np.stack((y, z)))
    expected = 2 * spatial + 0.2 * smape_in_numpy(b - a, z - y)
    assert second == pytest.approx(expected, rel=1e-4)  # float32


def test_pairs_of_frames_give_the_images_of_a_plain_run(trainable: Nppd) -> None:
    clip = small_clip(4)
    pairs = FramePairs(trainable)
    paired = [result.image.detach() for result in unroll(pairs, clip, 2.0)]
    plain = [result.image for result in run_clip(trainable, clip, 2.0)]
    assert pairs.first_images[0] is None
    firsts = [image.detach() for image in pairs.first_images[1:] if image is not None]
    for expected, image in zip(plain + plain[:3], paired + firsts, strict=True):
        torch.testing.assert_close(image, expected)


def test_the_gradient_of_a_pair_crosses_one_frame_and_no_more(trainable: Nppd) -> None:
    pairs = FramePairs(trainable)
    state = pairs.start(SIZE)
    clip = small_clip(3)
    for frame in clip:
        samples = read_samples(frame, 2)
        samples.radiance.requires_grad_()
        image, state = pairs.denoise(frame.gbuffer, samples, state)
        assert not state.state.irradiance.requires_grad
    image.sum().backward()
    assert samples.radiance.grad.abs().sum() > 0
    assert pairs.first_images[2].requires_grad
