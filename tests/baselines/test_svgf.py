"""SVGF: equal to plain loops; fixed points, noise reduction, and history as in the formulas."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.svgf.history import History, reproject_history
from baselines.svgf.method import VARIANTS, Edges, Svgf, atrous_pass, build
from rlbench.frames import GBuffer, Size
from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import atrous_stencil
from tests.baselines import wavelet_twins
from tests.baselines.moving import FRAMES, frame
from tests.baselines.noise import array, exponential_noise, one_sample, wall

CPU = torch.device("cpu")


def isolated_pixels(h: int, w: int) -> GBuffer:
    """A wall without normals, so that all neighbours have zero weight."""
    return wall(h, w, normal=torch.zeros(1, 3, h, w))


def run(method: Svgf, gbuffers: list[GBuffer], radiances: list[Tensor]) -> list[Tensor]:
    n, _, h, w = radiances[0].shape
    state, images = method.start(Size(n, h, w)), []
    for gbuffer, radiance in zip(gbuffers, radiances, strict=True):
        image, state = method.denoise(gbuffer, one_sample(radiance), state)
        images.append(image)
    return images


@pytest.fixture(params=[False, True], ids=["taps", "windows"])
def either_form(request, monkeypatch):
    """Taps in place, or windows as torch.compile sees them."""
    monkeypatch.setattr("baselines.svgf.method.is_compiling", lambda: request.param)


@pytest.mark.usefixtures("either_form")
@pytest.mark.parametrize("variant", VARIANTS)
def test_every_frame_equals_plain_loops(variant):
    """Moving surfaces, disocclusions, background, an emitter, fireflies."""
    method = build(variant, CPU, None)
    c = method.config
    numbers = c.alpha_color, c.alpha_moments, c.passes, c.feedback_tap, c.sigma_luminance
    frames = [frame(index) for index in range(FRAMES)]
    images = run(method, [f.gbuffer for f in frames], [f.radiance for f in frames])
    history = None
    for moving, image in zip(frames, images, strict=True):
        expected, history = wavelet_twins.svgf(moving.noisy, moving.arrays, history, *numbers)
        # cosines in float32 to the power 128, and variance as a difference of squares
        np.testing.assert_allclose(array(image), expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("step", [1, 2, 4, 8, 16])
def test_a_pass_without_edges_reduces_the_variance_of_noise_to_7_percent(step):
    side = 4 * step + 3
    flat = PaddedRows(1, side, side, margin=2 * step)
    ones = flat.pack(torch.ones(1, 1, side, side))
    zero = torch.zeros_like(ones)
    edges = Edges(flat.pack(wall(side, side).normal), zero, zero)
    sums = atrous_pass(flat, atrous_stencil(step), edges, (zero, zero), ones, ones)
    middle = flat.unpack(sums.variance / sums.weight.square())[0, 0, side // 2, side // 2]
    assert float(middle) == pytest.approx((70 / 256) ** 2, rel=1e-6)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("frames", [4, 40])
def test_a_static_image_is_the_exponential_mean_of_its_frames(variant, frames):
    """Early frames weigh the same; later ones alpha_color, up to a history of 32 frames."""
    method = build(variant, CPU, None)
    light = [exponential_noise(1, 3, 4, 5, seed=seed) for seed in range(frames)]
    expected = torch.zeros(1, 3, 4, 5, dtype=torch.float64)
    for index, radiance in enumerate(light):
        alpha = max(method.config.alpha_color, 1 / min(index + 1, 32))
        expected += alpha * (radiance - expected)
    image = run(method, [isolated_pixels(4, 5)] * frames, light)[-1]
    torch.testing.assert_close(image.double(), expected, rtol=1e-5, atol=1e-6)


def reproject_columns(depth: Tensor, gbuffer: GBuffer) -> Tensor:
    """From a frame with this depth, in which every pixel has the number of its column."""
    h, w = depth.shape[2:]
    flat = PaddedRows(1, h, w, margin=8)
    columns = torch.arange(w).float().expand(1, 5, h, w)
    mean = torch.cat((columns, torch.ones_like(depth)), 1)
    history = History(flat.pack(mean), flat.pack(depth), flat.pack(wall(h, w).normal))
    return reproject_history(flat, history, gbuffer.motion, gbuffer.depth, gbuffer.normal)


def test_bilinear_taps_on_another_surface_are_rejected():
    """At a depth edge and half a pixel of motion, the tap beyond the edge does not count."""
    depth = torch.full((1, 1, 4, 8), 5.0)
    depth[..., 4:] = 9
    motion = torch.full((1, 2, 4, 8), 0.0)
    motion[:, 0] = 0.5
    reprojected = reproject_columns(depth, wall(4, 8, motion, depth=depth))
    # column 3 lies between columns 3 (same surface) and 4 (another one); column 1 between 1 and 2
    assert reprojected[0, 0, 0, [1, 3]].tolist() == [1.5, 3]


@pytest.mark.parametrize(
    ("offset", "changed"),
    [
        (0.0, {"depth": torch.full((1, 1, 4, 8), 6.0)}),
        (0.0, {"normal": torch.zeros(1, 3, 4, 8)}),
        *((offset, {}) for offset in (-1e30, -100.0, 100.0, 1e30, torch.nan, torch.inf)),
    ],
)
def test_pixels_of_other_surfaces_and_from_outside_have_no_history(offset, changed):
    gbuffer = wall(4, 8, torch.full((1, 2, 4, 8), offset), **changed)
    assert not reproject_columns(wall(4, 8).depth, gbuffer).any()


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_nonfinite_pixel_keeps_its_history_and_affects_no_other(bad):
    light = [exponential_noise(1, 3, 9, 9, seed=seed) for seed in range(3)]
    damaged = [radiance.clone() for radiance in light]
    damaged[2][..., 4, 4] = bad
    intact_images, damaged_images = (
        run(build("", CPU, None), [isolated_pixels(9, 9)] * 3, radiances)
        for radiances in (light, damaged)
    )
    expected = intact_images[2].clone()
    expected[..., 4, 4] = intact_images[1][..., 4, 4]
    torch.testing.assert_close(damaged_images[2], expected)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_a_state_that_is_not_finite_is_no_history(bad):
    method, gbuffer = build("", CPU, None), wall(9, 11)
    samples = one_sample(exponential_noise(1, 3, 9, 11))
    _, state = method.denoise(gbuffer, samples, method.start(Size(1, 9, 11)))
    damaged = state._replace(accumulated=torch.full_like(state.accumulated, bad))
    image, after = method.denoise(gbuffer, samples, damaged)
    assert image.isfinite().all()
    assert after.accumulated.isfinite().all()
