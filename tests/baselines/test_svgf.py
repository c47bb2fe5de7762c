"""SVGF: equal to plain loops; fixed points, noise reduction, and history as in the formulas."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.svgf.history import History, accumulate, reproject_history
from baselines.svgf.method import VARIANTS, Edges, Svgf, atrous_pass, build
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.demodulation import reflectance
from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import atrous_taps
from tests.baselines import wavelet_twins
from tests.baselines.moving import FRAMES, frame

CPU = torch.device("cpu")


def one_sample(radiance: Tensor) -> Samples:
    """One sample per pixel."""
    n, _, h, w = radiance.shape
    return Samples(radiance[:, None], torch.ones(n, 1, h, w, dtype=torch.int64))


def wall(h: int, w: int, motion: Tensor | None = None, **changed: Tensor) -> GBuffer:
    """The G-buffer of a white wall that faces the camera."""
    buffers = {
        "albedo": torch.ones(1, 3, h, w),
        "normal": torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).repeat(1, 1, h, w),
        "depth": torch.full((1, 1, h, w), 5.0),
        **changed,
    }
    if motion is not None:
        buffers["motion"] = motion
    return GBuffer(buffers, static=motion is None)


def isolated_pixels(h: int, w: int, motion: Tensor | None = None) -> GBuffer:
    """A wall without normals, so that all neighbours have zero weight."""
    return wall(h, w, motion, normal=torch.zeros(1, 3, h, w))


def noise(*size: int, seed: int = 0) -> Tensor:
    return torch.empty(size).exponential_(generator=torch.Generator().manual_seed(seed))


def run(method: Svgf, gbuffers: list[GBuffer], radiances: list[Tensor]) -> list[Tensor]:
    n, _, h, w = radiances[0].shape
    state, images = method.start(Size(n, h, w)), []
    for gbuffer, radiance in zip(gbuffers, radiances, strict=True):
        image, state = method.denoise(gbuffer, one_sample(radiance), state)
        images.append(image)
    return images


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_frame_equals_plain_loops(variant):
    """Moving surfaces, disocclusions, background, an emitter, fireflies."""
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
    images = run(method, [f.gbuffer for f in frames], [f.radiance for f in frames])
    history = None
    for moving, image in zip(frames, images, strict=True):
        expected, history = wavelet_twins.svgf(moving.noisy, moving.arrays, history, *numbers)
        # cosines in float32 to the power 128, and variance as a difference of squares
        np.testing.assert_allclose(image[0].permute(1, 2, 0), expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
def test_constant_irradiance_is_unchanged(variant):
    """For any texture, geometry and motion."""
    frames = [frame(index) for index in range(FRAMES)]
    lit_images = [3 * reflectance(f.gbuffer.albedo) for f in frames]
    for image, expected in zip(
        run(build(variant, CPU, None), [f.gbuffer for f in frames], lit_images),
        lit_images,
        strict=True,
    ):
        torch.testing.assert_close(image, expected, rtol=1e-5, atol=1e-6)  # float32 sums


@pytest.mark.parametrize("step", [1, 2, 4, 8, 16])
def test_a_pass_without_edges_reduces_the_variance_of_noise_to_7_percent(step):
    side = 4 * step + 3
    flat = PaddedRows(1, side, side, margin=2 * step)
    features = {"normal": (0.0, 0.0, 1.0), "depth": (0.0,), "depth_decay": (0.0,)}
    edges = Edges(
        **{
            k: flat.pack(torch.tensor(v).view(1, -1, 1, 1).expand(1, -1, side, side))
            for k, v in features.items()
        }
    )
    zero, ones = torch.zeros_like(edges.depth), flat.pack(torch.ones(1, 1, side, side))
    sums = atrous_pass(flat, atrous_taps(step), edges, (zero, zero), ones, ones)
    middle = flat.unpack(sums.variance / sums.weight.square())[0, 0, side // 2, side // 2]
    assert float(middle) == pytest.approx((70 / 256) ** 2, rel=1e-6)


def test_a_pass_without_edges_is_the_spline():
    """Equal to a dilated convolution, away from the border."""
    flat = PaddedRows(2, 15, 17, margin=4)
    image = noise(2, 3, 15, 17)
    normal = torch.zeros(2, 3, 15, 17)
    normal[:, 2] = 1
    zero = flat.pack(torch.zeros(2, 1, 15, 17))
    sums = atrous_pass(
        flat,
        atrous_taps(2),
        Edges(flat.pack(normal), zero, zero),
        (zero, zero),
        flat.pack(image),
        zero,
    )
    kernel = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    kernel = (kernel[:, None] * kernel).expand(3, 1, 5, 5)
    expected = torch.nn.functional.conv2d(image, kernel, dilation=2, groups=3)
    filtered = flat.unpack(sums.values / sums.weight)[..., 4:-4, 4:-4]
    torch.testing.assert_close(filtered, expected)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("frames", [4, 40])
def test_a_static_image_is_the_exponential_mean_of_its_frames(variant, frames):
    """Early frames weigh the same; later ones alpha_color, up to a history of 32 frames."""
    method = build(variant, CPU, None)
    light = [noise(1, 3, 4, 5, seed=seed) for seed in range(frames)]
    expected = torch.zeros(1, 3, 4, 5, dtype=torch.float64)
    for index, radiance in enumerate(light):
        alpha = max(method.config.alpha_color, 1 / min(index + 1, 32))
        expected += alpha * (radiance - expected)
    image = run(method, [isolated_pixels(4, 5)] * frames, light)[-1]
    torch.testing.assert_close(image.double(), expected, rtol=1e-5, atol=1e-6)


def test_a_pan_by_whole_pixels_averages_visible_surfaces():
    radiance, speed = noise(1, 3, 8, 20), 2
    light = [radiance[..., speed * i : speed * i + 12] * (1 + i) for i in range(4)]
    motion = torch.zeros(1, 2, 8, 12)
    motion[:, 0] = speed
    gbuffer, flat = wall(8, 12, motion), PaddedRows(1, 8, 12, margin=32)
    history = build("", CPU, None).start(Size(1, 8, 12))
    for image in light:
        reprojected = reproject_history(
            flat, history, gbuffer.motion, gbuffer.depth, gbuffer.normal
        )
        mean = accumulate(image, torch.tensor(True), reprojected, (0.2, 0.2))
        rows = flat.pack(torch.cat((mean.irradiance, mean.moments, mean.length), 1))
        history = History(rows, flat.pack(gbuffer.depth), flat.pack(gbuffer.normal))
    expected = radiance[..., 6:12] * (1 + 2 + 3 + 4) / 4
    torch.testing.assert_close(mean.irradiance[..., :6], expected)
    # the last column was further outside the image than the 3 x 3 box reaches
    assert mean.length[0, 0, 0, [0, 5, 11]].tolist() == [4, 4, 1]


def test_bilinear_taps_on_another_surface_are_rejected():
    """At a depth edge and half a pixel of motion, the tap beyond the edge does not count."""
    depth = torch.full((1, 1, 4, 8), 5.0)
    depth[..., 4:] = 9
    history, flat = _column_history(depth)
    motion = torch.full((1, 2, 4, 8), 0.0)
    motion[:, 0] = 0.5
    reprojected = reproject_history(flat, history, motion, depth, wall(4, 8).normal)
    # column 3 lies between columns 3 (same surface) and 4 (another one); column 1 between 1 and 2
    assert reprojected[0, 0, 0, [1, 3]].tolist() == [1.5, 3]


@pytest.mark.parametrize(
    ("buffer", "value"), [("depth", 5.0 * 1.2), ("normal", 0.0)], ids=["depth", "normal"]
)
def test_disoccluded_pixels_have_no_history(buffer, value):
    history, flat = _column_history(torch.full((1, 1, 4, 8), 5.0))
    gbuffer = wall(
        4, 8, torch.zeros(1, 2, 4, 8), **{buffer: torch.full_like(wall(4, 8).extra(buffer), value)}
    )
    reprojected = reproject_history(flat, history, gbuffer.motion, gbuffer.depth, gbuffer.normal)
    assert (reprojected == 0).all()


@pytest.mark.parametrize("offset", [-1e30, -100.0, 100.0, 1e30, float("nan"), float("inf")])
def test_motion_from_outside_the_image_gives_no_history(offset):
    history, flat = _column_history(torch.full((1, 1, 4, 8), 5.0))
    gbuffer = wall(4, 8, torch.full((1, 2, 4, 8), offset))
    assert (
        reproject_history(flat, history, gbuffer.motion, gbuffer.depth, gbuffer.normal) == 0
    ).all()


def test_background_and_emitters_are_not_filtered():
    moving = frame(0)
    (image,) = run(build("", CPU, None), [moving.gbuffer], [moving.radiance])
    unfiltered = (moving.gbuffer.albedo == 0).all(1, keepdim=True).expand_as(image)
    assert unfiltered.any()
    assert torch.equal(image[unfiltered], moving.radiance[unfiltered])


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_nonfinite_pixel_keeps_its_history_and_affects_no_other(bad):
    light = [noise(1, 3, 9, 9, seed=seed) for seed in range(3)]
    damaged = [radiance.clone() for radiance in light]
    damaged[2][..., 4, 4] = bad
    intact_images, damaged_images = (
        run(build("", CPU, None), [isolated_pixels(9, 9)] * 3, radiances)
        for radiances in (light, damaged)
    )
    expected = intact_images[2].clone()
    expected[..., 4, 4] = intact_images[1][..., 4, 4]
    torch.testing.assert_close(damaged_images[2], expected)


def _column_history(depth: Tensor) -> tuple[History, PaddedRows]:
    """A history of length 1 on a wall at `depth`, whose values are the column indices."""
    h, w = depth.shape[2:]
    flat = PaddedRows(1, h, w, margin=8)
    columns = torch.arange(w).float().expand(1, 5, h, w)
    mean = torch.cat((columns, torch.ones_like(depth)), 1)
    return History(flat.pack(mean), flat.pack(depth), flat.pack(wall(h, w).normal)), flat


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_a_state_that_is_not_finite_is_no_history(bad):
    method, gbuffer = build("", CPU, None), wall(9, 11)
    samples = one_sample(noise(1, 3, 9, 11))
    _, state = method.denoise(gbuffer, samples, method.start(Size(1, 9, 11)))
    damaged = state._replace(accumulated=torch.full_like(state.accumulated, bad))
    image, after = method.denoise(gbuffer, samples, damaged)
    assert image.isfinite().all()
    assert after.accumulated.isfinite().all()
