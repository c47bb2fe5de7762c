"""Accumulation by rule: densities equal loops, memory closed forms."""

from __future__ import annotations

from itertools import product

import torch
from torch import Tensor

from baselines.accumulate.density import (
    DENSITY_RULES,
    MAX_DENSITY,
    UNIFORM_SHARE,
    contrast,
    mix_with_uniform,
)
from baselines.accumulate.memory import (
    TRUST,
    History,
    Memory,
    accumulate_frame,
    empty_memory,
    reproject_memory,
)
from baselines.accumulate.method import BLEND
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.ops.accumulation import AccumulatedRadiance, frame_radiance, surface_features
from rlbench.ops.transfer import log_forward, log_inverse
from tests.baselines.noise import random_tensor, read_samples

SIZE = Size(1, 24, 32)


def history(image: Tensor, **changed: Tensor) -> History:
    """A history of equal surfaces, with this image in log transfer."""
    one = torch.ones_like(image[:, :1])
    radiance = AccumulatedRadiance(log_inverse(image), one, one)
    known = {"radiance": radiance, "image": image, "change": one, "similarity": one}
    return History(**{**known, "static_mask": one > 2, **changed})


def window(image: Tensor, y: int, x: int, radius: int) -> Tensor:
    """The window around a pixel, with border pixels repeated [c side side]."""
    h, w = image.shape[-2:]
    steps = range(-radius, radius + 1)
    rows = [min(max(y + step, 0), h - 1) for step in steps]
    columns = [min(max(x + step, 0), w - 1) for step in steps]
    return image[0][:, rows][:, :, columns]


def test_contrast_equals_a_loop_over_pixels():
    image = random_tensor(1, 3, 9, 11)
    rough = torch.zeros(1, 1, 9, 11)
    for y, x in product(range(9), range(11)):
        mean = window(image, y, x, 1).mean((1, 2))
        rough[0, 0, y, x] = (image[0, :, y, x] - mean).abs().mean()
    expected = [float(window(rough, y, x, 1).mean()) for y, x in product(range(9), range(11))]
    found = contrast(history(image)).flatten()
    torch.testing.assert_close(found, torch.tensor(expected))  # float32 sums of nine


def test_the_deviation_of_samples_is_that_of_a_coin_relative_to_the_image():
    """Half of the samples are 0, half are 2: deviation 1 around a mean of 1, plus 0.05."""
    one = torch.ones(1, 1, 9, 9)
    light = AccumulatedRadiance(one.expand(-1, 3, -1, -1), 2 * one, one)
    image = log_forward(light.mean)
    found = DENSITY_RULES["deviation"](history(image, radiance=light))
    torch.testing.assert_close(found, one / 1.05)


def test_the_denoised_deviation_is_half_of_the_squared_change_under_a_root():
    """Two independent images of deviation s differ by 2 s^2 in the mean square."""
    change = torch.full((1, 1, 9, 9), 2 * 0.3**2)
    found = DENSITY_RULES["denoised deviation"](history(random_tensor(1, 3, 9, 9), change=change))
    torch.testing.assert_close(found, torch.full_like(change, 0.3))


def test_every_pixel_gets_half_of_the_mean_and_none_more_than_four_times():
    rule = torch.zeros(1, 1, 20, 20)
    rule[..., 3, 4] = 1.0
    density = mix_with_uniform(rule, torch.ones_like(rule))
    assert density.min() == UNIFORM_SHARE
    assert density.max() == density[..., 3, 4] == UNIFORM_SHARE + MAX_DENSITY


def test_new_pixels_are_sampled_like_the_roughest_tenth():
    rule, similarity = torch.arange(1.0, 102.0).view(1, 1, 1, 101), torch.ones(1, 1, 1, 101)
    similarity[..., 0] = 0.0
    density = mix_with_uniform(rule, similarity)
    expected = density[..., 90]  # of the values 2 to 101, the one with 10 above it: 91
    assert torch.allclose(density[..., 0], expected, atol=0.02)  # ranks are rounded


def test_without_history_the_density_is_uniform():
    rule = random_tensor(1, 1, 9, 11)
    density = mix_with_uniform(rule, torch.zeros_like(rule))
    assert float(density.max() - density.min()) == 0


def test_a_still_camera_averages_all_samples():
    """With noise of a hundredth, which contradicts no history."""
    clip, generator = procedural_clip(3, SIZE, 6, static=True), torch.Generator().manual_seed(0)
    memory, samples = empty_memory(clip.size, torch.device("cpu")), []
    for frame in clip:
        noise = torch.rand(1, 8, 1, SIZE.h, SIZE.w, generator=generator)
        samples.append(frame.reference.mean[:, None] * (0.99 + 0.02 * noise))
        current = frame_radiance(samples[-1], torch.full((1, 1, SIZE.h, SIZE.w), 8))
        light, _ = accumulate_frame(reproject_memory(frame.gbuffer, memory), current)
        g = frame.gbuffer
        surface = surface_features(g.normal, g.albedo, g.depth)
        memory = Memory(light, light.mean, memory.change, surface, memory.age + 1)
    # antilag takes up to a two-thousandth of the noise for a change
    full = torch.full_like(memory.radiance.accumulated_spp, 48.0)
    torch.testing.assert_close(memory.radiance.accumulated_spp, full, rtol=2e-3, atol=0)
    mean = torch.cat(samples, 1).mean(1)
    torch.testing.assert_close(memory.radiance.mean, mean, rtol=1e-4, atol=1e-6)


def test_the_weight_of_moving_surfaces_is_a_geometric_series():
    """Equal surfaces that move and equal light: weights 1 + 0.8 + 0.64 + ..."""
    flat = torch.ones(1, 1, 9, 64)
    past = history(torch.zeros(1, 3, 9, 64))
    light = AccumulatedRadiance(flat.expand(-1, 3, -1, -1), flat, flat)
    for _ in range(4):
        light, _ = accumulate_frame(
            past._replace(radiance=light),
            past.radiance._replace(mean=light.mean, second_moment=light.second_moment),
        )
    expected = sum(TRUST**k for k in range(5))
    torch.testing.assert_close(light.accumulated_spp, torch.full_like(flat, expected))


def test_the_previous_image_has_the_weight_of_the_rule():
    """A network that shows black: what is left of the last image in log transfer is its weight."""
    method = registry.load_method("accumulate")
    for weight in method.network.parameters():
        weight.zero_()
    (frame,) = procedural_clip(5, SIZE, 1, static=True)
    samples = read_samples(frame, 2)
    _, memory = method.denoise(frame.gbuffer, samples, method.start(SIZE))
    last = torch.full_like(memory.image, 0.5)
    state = Memory(memory.radiance, last, memory.change, memory.surface, 1)
    image, _ = method.denoise(frame.gbuffer, samples, state)
    share = log_forward(image) / log_forward(last)
    torch.testing.assert_close(share, torch.full_like(share, BLEND), rtol=1e-3, atol=1e-4)
