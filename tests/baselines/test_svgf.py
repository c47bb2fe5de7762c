"""SVGF: equal to its twin in loops; fixed points, noise and memory as the formulas say."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.svgf import FAMILY
from baselines.svgf.history import History, accumulate, reproject_history
from baselines.svgf.method import BASE, VARIANTS, Svgf, build
from baselines.svgf.wavelet import Edges, atrous_pass
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import reflectance
from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import atrous_taps
from tests.baselines import wavelet_twins
from tests.baselines.moving import FRAMES, frame

CPU = torch.device("cpu")


def one(radiance: Tensor) -> Samples:
    """One sample a pixel."""
    n, _, h, w = radiance.shape
    return Samples(radiance[:, None], torch.ones(n, 1, h, w, dtype=torch.int64))


def plain(h: int, w: int, motion: Tensor | None = None, **changed: Tensor) -> GBuffer:
    """A white wall that faces the camera."""
    buffers = {
        "albedo": torch.ones(1, 3, h, w),
        "normal": torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).repeat(1, 1, h, w),
        "depth": torch.full((1, 1, h, w), 5.0),
        **changed,
    }
    if motion is not None:
        buffers["motion"] = motion
    return GBuffer(buffers, static=motion is None)


def lonely(h: int, w: int, motion: Tensor | None = None) -> GBuffer:
    """A wall whose pixels look every way, so that no neighbour has a weight."""
    return plain(h, w, motion, normal=torch.zeros(1, 3, h, w))


def noise(*size: int, seed: int = 0) -> Tensor:
    return torch.empty(size).exponential_(generator=torch.Generator().manual_seed(seed))


def run(method: Svgf, views: list[GBuffer], light: list[Tensor]) -> list[Tensor]:
    n, _, h, w = light[0].shape
    state, images = method.start(Size(n, h, w)), []
    for gbuffer, radiance in zip(views, light, strict=True):
        image, state = method.denoise(gbuffer, one(radiance), state)
        images.append(image)
    return images


def test_metadata_is_readable_without_torch():
    code = "import sys, baselines.svgf; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_variants_of_the_family_are_those_of_the_table():
    assert set(FAMILY.variants) == set(VARIANTS)


def test_falcor_differs_in_memory_passes_and_tolerance():
    differ = {
        f.name for f in fields(BASE) if getattr(BASE, f.name) != getattr(VARIANTS["falcor"], f.name)
    }
    assert differ == {"keep_light", "passes", "feedback", "sigma_light"}


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_frame_equals_its_twin_in_loops(variant):
    """Moving and resting surfaces, what comes into view, background, a lamp, fireflies."""
    method = build(variant, CPU, None)
    config = method.config
    numbers = (
        config.alpha_color,
        config.alpha_moments,
        config.passes,
        config.feedback_tap,
        config.sigma_luminance,
    )
    frames = [frame(index) for index in range(FRAMES)]
    found = run(method, [f.gbuffer for f in frames], [f.radiance for f in frames])
    memory = None
    for each, image in zip(frames, found, strict=True):
        expected, memory = wavelet_twins.svgf(each.noisy, each.arrays, memory, *numbers)
        # cosines in float32 to the power 128, and variance as a difference of squares
        np.testing.assert_allclose(image[0].permute(1, 2, 0), expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
def test_constant_irradiance_stays_as_it_is(variant):
    """Whatever the texture, the shapes and the motion."""
    frames = [frame(index) for index in range(FRAMES)]
    lit = [3 * reflectance(f.gbuffer.albedo) for f in frames]
    for image, expected in zip(
        run(build(variant, CPU, None), [f.gbuffer for f in frames], lit), lit, strict=True
    ):
        torch.testing.assert_close(image, expected, rtol=1e-5, atol=1e-6)  # float32 sums


@pytest.mark.parametrize("step", [1, 2, 4, 8, 16])
def test_a_pass_without_edges_cuts_the_variance_of_noise_to_7_percent(step):
    side = 4 * step + 3
    flat = PaddedRows(1, side, side, margin=2 * step)
    flatland = {"normal": (0.0, 0.0, 1.0), "depth": (0.0,), "decay": (0.0,)}
    edges = Edges(
        **{
            k: flat.pack(torch.tensor(v).view(1, -1, 1, 1).expand(1, -1, side, side))
            for k, v in flatland.items()
        }
    )
    zero, ones = torch.zeros_like(edges.depth), flat.pack(torch.ones(1, 1, side, side))
    sums = atrous_pass(flat, atrous_taps(step), edges, (zero, zero), ones, ones)
    middle = flat.unpack(sums.variance / sums.weight.square())[0, 0, side // 2, side // 2]
    assert float(middle) == pytest.approx((70 / 256) ** 2, rel=1e-6)


def test_a_pass_without_edges_is_the_spline():
    """Against a dilated convolution, away from the border."""
    flat = PaddedRows(2, 15, 17, margin=4)
    image = noise(2, 3, 15, 17)
    even = torch.zeros(2, 3, 15, 17)
    even[:, 2] = 1
    zero = flat.pack(torch.zeros(2, 1, 15, 17))
    sums = atrous_pass(
        flat,
        atrous_taps(2),
        Edges(flat.pack(even), zero, zero),
        (zero, zero),
        flat.pack(image),
        zero,
    )
    kernel = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    kernel = (kernel[:, None] * kernel).expand(3, 1, 5, 5)
    expected = torch.nn.functional.conv2d(image, kernel, dilation=2, groups=3)
    found = flat.unpack(sums.values / sums.weight)[..., 4:-4, 4:-4]
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("frames", [1, 4, 25, 40])
def test_what_stands_still_is_the_exponential_mean_of_its_frames(variant, frames):
    """Early frames weigh the same; later ones `keep_light`, for a history of 32 frames or less."""
    method = build(variant, CPU, None)
    light = [noise(1, 3, 4, 5, seed=seed) for seed in range(frames)]
    expected = torch.zeros(1, 3, 4, 5, dtype=torch.float64)
    for index, each in enumerate(light):
        share = max(method.config.alpha_color, 1 / min(index + 1, 32))
        expected += share * (each - expected)
    found = run(method, [lonely(4, 5)] * frames, light)[-1]
    torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=1e-6)


def test_a_pan_over_whole_pixels_averages_what_stays_in_view():
    wall, speed = noise(1, 3, 8, 20), 2
    light = [wall[..., speed * i : speed * i + 12] * (1 + i) for i in range(4)]
    motion = torch.zeros(1, 2, 8, 12)
    motion[:, 0] = speed
    gbuffer, flat = plain(8, 12, motion), PaddedRows(1, 8, 12, margin=32)
    past = build("", CPU, None).start(Size(1, 8, 12))
    for each in light:
        found = reproject_history(flat, past, gbuffer.motion, gbuffer.depth, gbuffer.normal)
        mean = accumulate(each, torch.tensor(True), found, (0.2, 0.2))
        rows = flat.pack(torch.cat((mean.irradiance, mean.moments, mean.length), 1))
        past = History(rows, flat.pack(gbuffer.depth), flat.pack(gbuffer.normal))
    expected = wall[..., 6:12] * (1 + 2 + 3 + 4) / 4
    torch.testing.assert_close(mean.irradiance[..., :6], expected)
    # the last column was further outside than a 3 x 3 box around it reaches
    assert mean.length[0, 0, 0, [0, 5, 11]].tolist() == [4, 4, 1]


def test_no_bilinear_tap_is_taken_from_another_surface():
    """Half a pixel off, at an edge of depth, the tap beyond the edge is left out."""
    depth = torch.full((1, 1, 4, 8), 5.0)
    depth[..., 4:] = 9
    past, flat = _remembered(depth)
    motion = torch.full((1, 2, 4, 8), 0.0)
    motion[:, 0] = 0.5
    found = reproject_history(flat, past, motion, depth, plain(4, 8).normal)
    # column 3 lies between columns 3 (kept) and 4 (another surface); column 1 between 1 and 2
    assert found[0, 0, 0, [1, 3]].tolist() == [1.5, 3]


@pytest.mark.parametrize(
    ("buffer", "value"), [("depth", 5.0 * 1.2), ("normal", 0.0)], ids=["depth", "normal"]
)
def test_what_was_hidden_is_not_found(buffer, value):
    past, flat = _remembered(torch.full((1, 1, 4, 8), 5.0))
    gbuffer = plain(
        4, 8, torch.zeros(1, 2, 4, 8), **{buffer: torch.full_like(plain(4, 8).extra(buffer), value)}
    )
    found = reproject_history(flat, past, gbuffer.motion, gbuffer.depth, gbuffer.normal)
    assert (found == 0).all()


@pytest.mark.parametrize("away", [-1e30, -100.0, 100.0, 1e30, float("nan"), float("inf")])
def test_motion_that_leads_outside_finds_nothing(away):
    past, flat = _remembered(torch.full((1, 1, 4, 8), 5.0))
    gbuffer = plain(4, 8, torch.full((1, 2, 4, 8), away))
    assert (reproject_history(flat, past, gbuffer.motion, gbuffer.depth, gbuffer.normal) == 0).all()


def test_background_and_lamps_pass_through():
    moving = frame(0)
    (image,) = run(build("", CPU, None), [moving.gbuffer], [moving.radiance])
    through = (moving.gbuffer.albedo == 0).all(1, keepdim=True).expand_as(image)
    assert through.any()
    assert torch.equal(image[through], moving.radiance[through])


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_one_broken_pixel_keeps_its_history_and_spoils_nothing(bad):
    light = [noise(1, 3, 9, 9, seed=seed) for seed in range(3)]
    broken = [each.clone() for each in light]
    broken[2][..., 4, 4] = bad
    whole, found = (run(build("", CPU, None), [lonely(9, 9)] * 3, some) for some in (light, broken))
    expected = whole[2].clone()
    expected[..., 4, 4] = whole[1][..., 4, 4]
    torch.testing.assert_close(found[2], expected)


def _remembered(depth: Tensor) -> tuple[History, PaddedRows]:
    """A history of length 1 whose colours tell the column, on a wall at `depth`."""
    h, w = depth.shape[2:]
    flat = PaddedRows(1, h, w, margin=8)
    columns = torch.arange(w).float().expand(1, 5, h, w)
    mean = torch.cat((columns, torch.ones_like(depth)), 1)
    return History(flat.pack(mean), flat.pack(depth), flat.pack(plain(h, w).normal)), flat
