"""IMCD: its filter against loops and box filters, what it remembers, and how it is trained."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor, nn

from baselines.imcd.filter import PreviousFrame, KernelSizes, apply_affinity_kernels
from baselines.imcd.method import Config, Imcd, State, build
from baselines.imcd.network import Encoder, Kernels, Networks
from baselines.imcd.train import losses, sharpness_penalty, training_task
from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import Frame, GBuffer, Reference, Samples, Size, StoredPool
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.run import run_clip

CPU = torch.device("cpu")
SIZE = Size(1, 16, 16)
SMALL = KernelSizes(spatial=5, temporal=3)


def drawn(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def small_clip(
    frames: int = 3, size: Size = SIZE, seed: int = 0, textured: bool = True
) -> InMemoryClip:
    """Noise around smooth light on a coloured surface, under a slow pan."""
    n, h, w = size
    albedo, shown = drawn(n, 3, *((h, w) if textured else (1, 1)), seed=3).expand(n, 3, h, w), []
    for i in range(frames):
        light = drawn(n, 3, 1, 1, seed=seed) * torch.linspace(0.2, 2, w).expand(n, 3, h, w)
        truth = light * albedo
        noise = -drawn(n, 8, 1, h, w, seed=seed + i + 1).clamp_min(1e-6).log()  # mean one
        buffers = {
            "albedo": albedo,
            "normal": nn.functional.normalize(drawn(n, 3, h, w, seed=2) - 0.5, dim=1),
            "depth": 1 + drawn(n, 1, h, w, seed=4),
            "motion": torch.full((n, 2, h, w), 0.5),
        }
        pool = StoredPool(truth[:, None] * noise, tuple(range(i, i + n)))
        shown.append(Frame(i, GBuffer(buffers), pool, Reference(truth, truth)))
    return InMemoryClip("small", "small", "", shown)


def bought(frame: Frame, count: int = 8) -> Samples:
    counts = torch.full_like(frame.gbuffer.depth, count, dtype=torch.int64)
    return Samples(frame.pool.read(frame.pool.empty(), counts), counts)


def kernels(h: int, w: int, sharpness: float | None = None, keep: float = 0.0) -> Kernels:
    """Distinct features; sharpness as drawn or as given, and then the centre weighs 1."""
    drawn_sharpness = 3 * drawn(1, 3, 1, h, w, seed=6)
    given = torch.full_like(drawn_sharpness, sharpness or 0.0)
    plain = sharpness is None
    return Kernels(
        features=drawn(1, 3, 8, h, w, seed=5),
        sharpness=drawn_sharpness if plain else given,
        centre_weight=drawn(1, 3, 1, h, w, seed=7) if plain else torch.ones(1, 3, 1, h, w),
        temporal_sharpness=3 * drawn(1, 1, h, w, seed=8),
        history_weight=torch.full((1, 1, h, w), keep),
    )


@pytest.fixture(scope="module")
def method() -> Imcd:
    return replace(build("", CPU, "random"), config=Config(SMALL))


@pytest.fixture(scope="module")
def learner() -> Imcd:
    """One whose weights can be trained, with small windows, for speed."""
    method = training_task("", CPU, seed=0).method
    assert isinstance(method, Imcd)
    return replace(method, config=Config(SMALL))


@pytest.mark.parametrize(("part", "count"), [("unet", 938_944), ("encoder", 2_464)])
def test_parameter_counts(part: str, count: int) -> None:
    module = Networks().get_submodule(part)
    assert sum(p.numel() for p in module.parameters()) == count


@pytest.mark.parametrize("size", [Size(1, 16, 16), Size(2, 17, 31), Size(1, 5, 40), Size(1, 1, 1)])
def test_any_size_goes_in_and_comes_out(method: Imcd, size: Size) -> None:
    for shown in run_clip(method, small_clip(2, size), spp=2.0):
        assert shown.image.shape == (size.n, 3, size.h, size.w)
        assert torch.isfinite(shown.image).all()


@pytest.mark.parametrize("side", [5, 11])
def test_without_sharpness_it_is_three_dilated_boxes(side: int) -> None:
    light = drawn(1, 3, 40, 30)
    expected = light[0].double().numpy()
    for dilation in (1, 2, 4):
        reach = side // 2 * dilation
        box = np.zeros((1, 2 * reach + 1, 2 * reach + 1))
        box[:, ::dilation, ::dilation] = 1
        total, area = (
            ndimage.correlate(each, box, mode="constant")
            for each in (expected, np.ones_like(expected))
        )
        expected = total / area
    found = apply_affinity_kernels(light, kernels(40, 30, sharpness=0.0), None, KernelSizes(side))
    # float32 sums of up to 121 terms, three times
    np.testing.assert_allclose(found[0].numpy(), expected, rtol=1e-5)


def test_where_no_two_pixels_are_alike_it_is_the_identity() -> None:
    light = drawn(1, 3, 20, 20)
    found = apply_affinity_kernels(light, kernels(20, 20, sharpness=1e6), None, KernelSizes())
    torch.testing.assert_close(found, light, rtol=1e-6, atol=0)  # the last bit of float32


def looped(light: Tensor, asked: Kernels, past: PreviousFrame | None, windows: KernelSizes) -> np.ndarray:
    """Eq. 4, 6, 7 and 8, a pixel and a neighbour at a time, [3 h w] in double precision."""
    _, _, h, w = light.shape
    image = light[0].double().numpy()
    features, sharpness, centre = (part[0].double().numpy() for part in asked[:3])
    for k, dilation in enumerate((1, 2, 4)):
        before, image = image, np.zeros_like(image)
        for y, x in np.ndindex(h, w):
            total, weights = np.zeros(3), 1e-10
            for v, u in _window(windows.spatial, y, x, dilation, h, w):
                distance = ((features[k, :, y, x] - features[k, :, v, u]) ** 2).sum()
                weight = np.exp(-sharpness[k, 0, y, x] * distance)
                weight = centre[k, 0, y, x] if (v, u) == (y, x) else weight
                total, weights = total + weight * before[:, v, u], weights + weight
            if past is not None and k == 2:
                remembered, old = past.features[0].double().numpy(), past.image[0].double().numpy()
                for v, u in _window(windows.temporal, y, x, 1, h, w):
                    distance = ((features[2, :, y, x] - remembered[:, v, u]) ** 2).sum()
                    weight = np.exp(-float(asked.temporal_sharpness[0, 0, y, x]) * distance)
                    weight *= float(past.valid[0, 0, v, u])
                    total, weights = total + weight * old[:, v, u], weights + weight
            image[:, y, x] = total / weights
    return image


def _window(side: int, y: int, x: int, dilation: int, h: int, w: int) -> list[tuple[int, int]]:
    steps = range(-(side // 2), side // 2 + 1)
    reached = ((y + i * dilation, x + j * dilation) for i in steps for j in steps)
    return [(v, u) for v, u in reached if 0 <= v < h and 0 <= u < w]


@pytest.mark.parametrize("remembers", [True, False])
def test_the_filter_equals_its_slow_twin(remembers: bool) -> None:
    light, asked = drawn(1, 3, 12, 12), kernels(12, 12)
    valid = drawn(1, 1, 12, 12, seed=9) > 0.3
    past = PreviousFrame(drawn(1, 8, 12, 12, seed=10), drawn(1, 3, 12, 12, seed=11), valid)
    past = past if remembers else None
    expected = looped(light, asked, past, SMALL)
    found = apply_affinity_kernels(light, asked, past, SMALL)
    np.testing.assert_allclose(found[0].numpy(), expected, rtol=1e-5)  # float32, 34 terms


def test_the_mean_over_full_slots_is_the_plain_mean() -> None:
    encoder, colours, gbuffer = Encoder(), drawn(2, 8, 3, 6, 7), drawn(2, 7, 6, 7, seed=1)
    every = torch.ones(2, 8, 1, 6, 7, dtype=torch.bool)
    samples = torch.cat((colours, gbuffer[:, None].expand(-1, 8, -1, -1, -1)), 2)
    expected = encoder.embed(samples.flatten(0, 1)).unflatten(0, (2, 8)).mean(1)
    # float32 sums of eight
    torch.testing.assert_close(encoder(colours, gbuffer, every), expected, rtol=1e-5, atol=1e-6)


def test_what_lies_in_empty_slots_does_not_count() -> None:
    encoder, colours, gbuffer = Encoder(), drawn(1, 8, 3, 6, 7), drawn(1, 7, 6, 7, seed=1)
    filled = torch.arange(8).view(1, 8, 1, 1, 1) < 1 + torch.arange(7)
    other = colours.where(filled, 5.0)
    filled = filled.expand(1, 8, 1, 6, 7)
    assert torch.equal(encoder(colours, gbuffer, filled), encoder(other, gbuffer, filled))


def test_the_order_of_samples_does_not_matter(method: Imcd) -> None:
    frame = small_clip().frames[0]
    samples = bought(frame)
    order = torch.tensor([3, 1, 7, 0, 2, 6, 5, 4])
    shuffled = replace(samples, radiance=samples.radiance[:, order])
    first, second = (
        method.denoise(frame.gbuffer, each, method.start(SIZE))[0] for each in (samples, shuffled)
    )
    # sums of eight in another order, through a U-Net; of values of order one
    torch.testing.assert_close(first, second, rtol=1e-5, atol=1e-6)


def test_before_the_first_frame_the_state_means_nothing(method: Imcd) -> None:
    frame = small_clip().frames[0]
    noise = State(*(drawn(1, c, 16, 16, seed=c) for c in (32, 3, 8, 3)), age=0)
    first, second = (
        method.denoise(frame.gbuffer, bought(frame), each)[0]
        for each in (method.start(SIZE), noise)
    )
    assert torch.equal(first, second)


def test_the_same_frame_again_changes_no_feature(method: Imcd) -> None:
    frame = small_clip().frames[0]
    still = replace(frame.gbuffer, static=True)
    _, first = method.denoise(still, bought(frame), method.start(SIZE))
    _, second = method.denoise(still, bought(frame), first)
    assert all(torch.equal(a, b) for a, b in zip(first[:3], second[:3], strict=True))


def test_the_same_frame_again_is_blended_with_the_first(method: Imcd) -> None:
    frame = small_clip().frames[0]
    still = replace(frame.gbuffer, static=True)
    _, first = method.denoise(still, bought(frame), method.start(SIZE))
    _, second, asked = method.step(still, bought(frame), first)
    past = PreviousFrame(first.features, first.denoised, torch.ones(1, 1, 16, 16, dtype=torch.bool))
    expected = apply_affinity_kernels(first.irradiance, asked, past, method.config.kernel_sizes)
    assert torch.equal(second.denoised, expected)
    assert not torch.equal(second.denoised, first.denoised)


@pytest.mark.parametrize("age", [0, 1], ids=["without history", "with history"])
def test_constant_light_stays_constant(method: Imcd, age: int) -> None:
    """Weights sum to one, whatever they are."""
    gbuffer = small_clip().frames[0].gbuffer
    reflectance = demodulation_albedo(filtered_albedo(gbuffer.albedo))
    samples = Samples((0.7 * reflectance)[:, None], torch.ones(1, 1, 16, 16, dtype=torch.int64))
    before = State(*(torch.full((1, c, 16, 16), 0.7) for c in (32, 3, 8, 3)), age)
    image, state = method.denoise(gbuffer, samples, before)
    # float32 sums of 242 weights, and one division by reflectance
    torch.testing.assert_close(state.denoised, torch.full_like(state.denoised, 0.7), rtol=1e-5, atol=0)
    torch.testing.assert_close(image, 0.7 * reflectance, rtol=1e-5, atol=0)


def test_later_the_state_counts(method: Imcd) -> None:
    frame = small_clip().frames[0]
    _, state = method.denoise(frame.gbuffer, bought(frame), method.start(SIZE))
    dark, bright = (
        method.denoise(frame.gbuffer, bought(frame), state._replace(image=state.denoised + more))[0]
        for more in (0.0, 9.0)
    )
    assert dark.mean() < bright.mean()


def test_a_bad_state_is_forgotten_where_it_is_bad(method: Imcd) -> None:
    frame = small_clip().frames[0]
    _, state = method.denoise(frame.gbuffer, bought(frame), method.start(SIZE))
    for part in state[:4]:
        part[..., 3, 3] = torch.nan
    image, after = method.denoise(frame.gbuffer, bought(frame), state)
    assert torch.isfinite(image).all()
    assert all(torch.isfinite(part).all() for part in after[:4])


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf, -1.0])
def test_a_bad_sample_leaves_the_image_finite(method: Imcd, bad: float) -> None:
    frame = small_clip().frames[0]
    radiance = frame.pool.radiance.clone()
    radiance[:, 2, :, 3, 3] = bad
    samples = replace(bought(frame), radiance=radiance)
    image, _ = method.denoise(frame.gbuffer, samples, method.start(SIZE))
    assert torch.isfinite(image).all()
    assert (image >= 0).all()


def test_lights_on_black_surfaces_keep_their_radiance() -> None:
    """Not a hundred times it, which neighbours would be flooded by."""
    frame = small_clip().frames[0]
    black = GBuffer({**frame.gbuffer.buffers, "albedo": torch.zeros(1, 3, 16, 16)})
    _, state = build("", CPU, "random").denoise(black, bought(frame), State(*_empty(), age=0))
    mean = bought(frame).mean
    torch.testing.assert_close(state.irradiance, mean / 1.01, rtol=1e-5, atol=0)  # float32 sums of 8


def _empty() -> list[Tensor]:
    return [torch.zeros(1, c, 16, 16) for c in (32, 3, 8, 3)]


def test_strain_is_the_mean_of_squares() -> None:
    asked = kernels(4, 4, sharpness=2.0)._replace(past_sharpness=torch.full((1, 1, 4, 4), 3.0))
    assert float(sharpness_penalty(asked)) == pytest.approx(2.0**2 + 3.0**2)


def test_the_loss_is_relative_error_of_images_and_a_quarter_of_that_of_their_change(
    learner: Imcd,
) -> None:
    clip = small_clip(2)
    (loss,) = losses(learner, clip, 2.0)
    images = [shown.image.double().numpy() for shown in run_clip(learner, clip, 2.0)]
    truths = [frame.reference.mean.double().numpy() for frame in clip]
    still = np.mean([_smape(*pair) for pair in zip(images, truths, strict=True)])
    changed = _smape(images[1] - images[0], truths[1] - truths[0])
    # of the two frames the first has no change; 1e-5 (a^2 + b^2) is below 1e-3 at the start
    assert float(loss.detach()) == pytest.approx(still + 0.25 * changed / 2, abs=1e-3)


def _smape(image: np.ndarray, truth: np.ndarray) -> float:
    return float((abs(image - truth) / (abs(image) + abs(truth) + 0.01)).mean())


def test_two_frames_reach_every_parameter(learner: Imcd) -> None:
    learner.networks.zero_grad()
    next(losses(learner, small_clip(2, Size(2, 32, 32)), 2.0)).backward()
    silent = [
        name
        for name, weight in learner.networks.named_parameters()
        if weight.grad is None or not weight.grad.abs().sum() > 0
    ]
    assert silent == []


@pytest.mark.parametrize(("frames", "count"), [(1, 1), (2, 1), (4, 2), (5, 3)])
def test_there_is_one_loss_for_each_two_frames(learner: Imcd, frames: int, count: int) -> None:
    found = 0
    for loss in losses(learner, small_clip(frames), 2.0):
        loss.backward()  # a graph left over from the loss before would raise here
        found += 1
    assert found == count


def test_a_few_steps_bring_the_loss_down() -> None:
    made = training_task("", CPU, seed=0)
    optimizer = torch.optim.Adam(made.networks.parameters(), 1e-3)
    clip, means = small_clip(2, Size(1, 32, 32), textured=False), []  # no pixel has its own albedo
    for _ in range(24):
        for loss in losses(replace(made.method, config=Config(SMALL)), clip, 2.0):
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            means.append(loss.item())
    assert means[-1] < 0.8 * means[0]


MEMORY = """
import resource, torch
torch.set_num_threads(1)
from baselines.imcd.method import build
from rlbench.frames import Size
from rlbench.clips.procedural.clip import procedural
from rlbench.run import run_clip

peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
method = build("", torch.device("cpu"), "random")
list(run_clip(method, procedural(0, Size(1, 32, 32), frames=2), 8.0))
before = peak()
for _ in run_clip(method, procedural(0, Size(1, 720, 720), frames=2), 8.0):
    pass
print(peak() - before)  # KiB
"""


@pytest.mark.slow
def test_two_frames_of_720x720_at_8_spp_take_less_than_2_gb() -> None:
    """What the process grows by: samples, views and references too, some 0.5 GB of it."""
    done = subprocess.run(
        [sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True
    )
    assert int(done.stdout) * 1024 < 2e9
