"""NTAS: network sizes, properties of its kernels, and the gradient that trains its sampler."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from baselines.ntas import TRAITS
from baselines.ntas.method import VARIANTS, Ntas, State, build
from baselines.ntas.network import Networks
from baselines.ntas.train import training_task
from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Frame, GBuffer, Reference, Samples, Size, StoredPool
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.run import run_clip

CPU = torch.device("cpu")
SIZE = Size(1, 16, 16)


def random_tensor(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def small_clip(frames: int = 3, size: Size = SIZE, seed: int = 0) -> InMemoryClip:
    """Noise around a smooth reference, with slow motion."""
    n, h, w = size
    clip_frames = []
    for i in range(frames):
        reference = random_tensor(n, 3, 1, 1, seed=seed) * torch.linspace(0.2, 2, w).expand(
            n, 3, h, w
        )
        noise = -random_tensor(n, 8, 1, h, w, seed=seed + i + 1).clamp_min(1e-6).log()  # mean one
        normal = nn.functional.normalize(random_tensor(n, 3, h, w, seed=2) - 0.5, dim=1)
        gbuffer = GBuffer(
            {
                "albedo": random_tensor(n, 3, h, w, seed=3),
                "normal": normal,
                "depth": 1 + random_tensor(n, 1, h, w, seed=4),
                "motion": torch.full((n, 2, h, w), 0.5),
            }
        )
        pool = StoredPool(reference[:, None] * noise, tuple(range(i, i + n)))
        clip_frames.append(Frame(i, gbuffer, pool, Reference(reference, reference)))
    return InMemoryClip("small", "small", "", clip_frames)


def half_noisy(seed: int) -> InMemoryClip:
    """A static grey image: noise on the left half only; only albedo distinguishes the halves."""
    clip_frames = []
    for frame in small_clip(2, Size(1, 32, 32), seed):
        left = torch.arange(32).expand(1, 1, 32, 32) < 16
        reference = torch.full((1, 3, 32, 32), 0.5)
        noise = -random_tensor(1, 8, 1, 32, 32, seed=100 * seed + frame.index).clamp_min(1e-6).log()
        radiance = torch.where(left[:, None], noise, 1.0) * reference[:, None]
        albedo = torch.where(left, 0.8, 0.3).expand(1, 3, 32, 32)
        gbuffer = GBuffer({**frame.gbuffer.buffers, "albedo": albedo}, static=True)
        pool = StoredPool(radiance, (frame.index,))
        clip_frames.append(Frame(frame.index, gbuffer, pool, Reference(reference, reference)))
    return InMemoryClip("half noisy", "half noisy", "", clip_frames)


@pytest.fixture(scope="module")
def method() -> Ntas:
    return build("", CPU, "random")


@pytest.mark.parametrize(
    ("part", "count"),
    [("sampler", 920_097), ("denoiser", 947_114), ("denoiser.heads", 7_150)],
)
def test_parameter_counts(part: str, count: int) -> None:
    # a U-Net of OIDN has 920,675 with 10 channels in and 3 out; 289 for each channel out, 864 in
    module = Networks().get_submodule(part)
    assert sum(p.numel() for p in module.parameters()) == count


@pytest.mark.parametrize("size", [Size(1, 16, 16), Size(2, 17, 31), Size(1, 5, 40), Size(1, 1, 1)])
def test_any_image_size_is_denoised(method: Ntas, size: Size) -> None:
    for result in run_clip(method, small_clip(2, size), spp=2.0):
        assert result.image.shape == (size.n, 3, size.h, size.w)
        assert torch.isfinite(result.image).all()


def test_density_is_positive_with_its_largest_at_one(method: Ntas) -> None:
    frame = next(iter(small_clip()))
    density = method.plan(frame.gbuffer, frame.pool.empty(), method.start(frame.pool.size))
    assert (density > 0).all()
    assert density.max() == 1


def test_extreme_sampler_outputs_still_give_every_pixel_some_density(method: Ntas) -> None:
    networks = Networks()
    networks.init_weights(seed=0)
    nn.init.normal_(
        networks.sampler.unet.dec_conv0.weight, 0, 1e3, torch.Generator().manual_seed(0)
    )
    frame = next(iter(small_clip()))
    steep = Ntas(networks)
    density = steep.plan(frame.gbuffer, frame.pool.empty(), steep.start(frame.pool.size))
    assert density.min() > 0


def test_the_first_frame_ignores_the_state(method: Ntas) -> None:
    frame = next(iter(small_clip()))
    samples = Samples(frame.pool.radiance, torch.full((1, 1, 16, 16), 8))
    zeros, noise = (
        State(light, age=0) for light in (torch.zeros(1, 3, 16, 16), random_tensor(1, 3, 16, 16))
    )
    assert torch.equal(
        method.denoise(frame.gbuffer, samples, zeros)[0],
        method.denoise(frame.gbuffer, samples, noise)[0],
    )


def test_a_later_frame_uses_the_state(method: Ntas) -> None:
    frame = next(iter(small_clip()))
    samples = Samples(frame.pool.radiance, torch.full((1, 1, 16, 16), 8))
    dark, bright = (State(torch.full((1, 3, 16, 16), light), age=1) for light in (0.0, 9.0))
    darker = method.denoise(frame.gbuffer, samples, dark)[0].mean()
    assert darker < method.denoise(frame.gbuffer, samples, bright)[0].mean()


def test_pixels_with_only_invalid_taps_ignore_the_history() -> None:
    networks = Networks()
    networks.init_weights(seed=0)
    features, irradiance = random_tensor(1, 13, 16, 16), random_tensor(1, 3, 16, 16, seed=1)
    valid = torch.zeros(1, 1, 16, 16, dtype=torch.bool)
    valid[..., 8:] = True
    dark = networks.denoiser(features, irradiance, torch.zeros(1, 3, 16, 16), valid)
    bright = networks.denoiser(features, irradiance, torch.full((1, 3, 16, 16), 1e3), valid)
    assert torch.equal(dark[..., :6], bright[..., :6])  # 5x5 taps reach two pixels
    assert (bright[..., 6:] > dark[..., 6:]).all()


@pytest.mark.parametrize("age", [0, 1], ids=["without history", "with history"])
def test_constant_irradiance_stays_constant(method: Ntas, age: int) -> None:
    """Kernels sum to one on every level, with and without history."""
    gbuffer = next(iter(small_clip())).gbuffer
    reflectance = demodulation_albedo(filtered_albedo(gbuffer.albedo))
    samples = Samples((0.7 * reflectance)[:, None], torch.ones(1, 1, 16, 16, dtype=torch.int64))
    image, state = method.denoise(gbuffer, samples, State(torch.full((1, 3, 16, 16), 0.7), age))
    # float32 through five levels and one division by reflectance
    torch.testing.assert_close(
        state.denoised, torch.full_like(state.denoised, 0.7), rtol=1e-5, atol=0
    )
    torch.testing.assert_close(image, 0.7 * reflectance, rtol=1e-5, atol=0)


def test_a_nonfinite_state_is_invalid_history(method: Ntas) -> None:
    frame = next(iter(small_clip()))
    samples = Samples(frame.pool.radiance, torch.full((1, 1, 16, 16), 8))
    light = torch.ones(1, 3, 16, 16)
    light[..., 3, 3] = torch.nan
    image, state = method.denoise(frame.gbuffer, samples, State(light, age=1))
    assert torch.isfinite(image).all()
    assert torch.isfinite(state.denoised).all()


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -1.0])
def test_an_invalid_sample_leaves_the_image_finite(method: Ntas, bad: float) -> None:
    frame = next(iter(small_clip()))
    radiance = frame.pool.radiance.clone()
    radiance[..., 3, 3] = bad
    samples = Samples(radiance, torch.full((1, 1, 16, 16), 8))
    image, _ = method.denoise(frame.gbuffer, samples, method.start(SIZE))
    assert torch.isfinite(image).all()
    assert (image >= 0).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_one_step_gives_every_parameter_of_both_networks_a_gradient(variant: str) -> None:
    task = training_task(variant, CPU, seed=0)
    next(task.losses(small_clip(2, Size(2, 32, 32)), 2.0)).backward()
    without_gradient = [
        name
        for name, weight in task.networks.named_parameters()
        if weight.grad is None or not weight.grad.abs().sum() > 0
    ]
    assert without_gradient == []


@pytest.mark.parametrize(("frames", "losses"), [(1, 1), (2, 1), (4, 2), (5, 3)])
def test_two_frames_give_one_loss(frames: int, losses: int) -> None:
    task = training_task("", CPU, seed=0)
    count = 0
    for loss in task.losses(small_clip(frames), 2.0):
        loss.backward()  # a graph shared with the previous loss would raise here
        count += 1
    assert count == losses


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_few_training_steps_lower_the_loss(variant: str) -> None:
    task = training_task(variant, CPU, seed=0)
    optimizer = torch.optim.Adam(task.networks.parameters(), 5e-4)
    clip, means = small_clip(2, Size(1, 32, 32)), []
    for _ in range(12):
        for loss in task.losses(clip, 2.0):
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            means.append(loss.item())
    assert means[-1] < 0.8 * means[0]


def test_the_sampler_learns_where_noise_is() -> None:
    task = training_task("", CPU, seed=0)
    optimizer = torch.optim.Adam(task.networks.parameters(), 5e-4)
    for seed in range(15):
        for loss in task.losses(half_noisy(seed), 3.0):
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    *_, result = run_clip(task.method, half_noisy(99), 3.0)
    left, right = result.samples.counts.float().mean((0, 1, 2)).view(2, 16).mean(1).tolist()
    assert left > 2 * right  # 3 and 3 before, 5 and 1 at best


def test_half_precision_differs_by_rounding_only(method: Ntas) -> None:
    frame = next(iter(small_clip()))
    samples = Samples(frame.pool.radiance, torch.full((1, 1, 16, 16), 8))
    image, _ = method.denoise(frame.gbuffer, samples, method.start(SIZE))
    with torch.autocast("cpu", torch.bfloat16):
        half, state = method.denoise(frame.gbuffer, samples, method.start(SIZE))
    assert state.denoised.dtype == torch.float32
    # bfloat16 has 8 bits, so logits of order one are off by 1/256, and weights by as much
    torch.testing.assert_close(half, image, rtol=3e-2, atol=0)


def test_direct_differs_from_the_base_variant_in_the_denoiser_only() -> None:
    assert replace(VARIANTS["direct"], denoiser=VARIANTS[""].denoiser) == VARIANTS[""]


def test_direct_is_a_u_net_with_three_output_channels() -> None:
    # 920,675 with 10 channels in; 3 more enter the first convolution and the last but two
    denoiser = build("direct", CPU, "random").networks.denoiser
    assert sum(p.numel() for p in denoiser.parameters()) == 920_675 + 3 * (32 + 64) * 9


def test_the_output_of_direct_is_between_zero_and_the_largest_half() -> None:
    networks = build("direct", CPU, "random").networks
    nn.init.normal_(
        networks.denoiser.unet.dec_conv0.weight, 0, 1e3, torch.Generator().manual_seed(0)
    )
    light = random_tensor(1, 3, 16, 16)
    valid = torch.ones(1, 1, 16, 16, dtype=torch.bool)
    irradiance = networks.denoiser(random_tensor(1, 13, 16, 16), light, light, valid)
    assert irradiance.min() == 0
    assert float(irradiance.max()) == pytest.approx(65504, rel=1e-4)  # exp of 15 in float32


def test_every_colour_of_direct_has_a_gradient_at_the_start() -> None:
    task = training_task("direct", CPU, seed=0)
    next(task.losses(small_clip(2, Size(2, 32, 32)), 2.0)).backward()
    assert (task.networks.denoiser.unet.dec_conv0.bias.grad != 0).all()


def test_the_seed_determines_the_weights() -> None:
    first, again, other = (training_task("", CPU, seed).networks for seed in (1, 1, 2))
    assert all(
        torch.equal(a, b) for a, b in zip(first.parameters(), again.parameters(), strict=True)
    )
    assert not torch.equal(first.denoiser.coarsest.weight, other.denoiser.coarsest.weight)


def test_every_pixel_gets_a_sample() -> None:
    assert TRAITS.min_samples == 1
    for result in run_clip(build("", CPU, "random"), small_clip(2), spp=1.5):
        assert int(result.samples.counts.min()) >= 1
        assert int(result.samples.counts.sum()) == round(1.5 * 256)
