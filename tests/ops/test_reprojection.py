"""Reprojection against shifts, kornia and a loop; validity; robustness."""

from __future__ import annotations

import math

import kornia
import pytest
import torch

from rlbench.ops.reprojection import reproject, reproject_bicubic, reproject_or_fill

N, C, H, W = 2, 3, 9, 14


def history() -> torch.Tensor:
    return torch.rand(N, C, H, W, generator=torch.Generator().manual_seed(0))


def motion(reach: float = 3.0) -> torch.Tensor:
    unit = torch.rand(N, 2, H, W, generator=torch.Generator().manual_seed(1))
    return (2 * unit - 1) * reach


def source(n: int, y: int, x: int) -> tuple[float, float]:
    """The position that pixel (x, y) of image n moves from."""
    dx, dy = motion()[n, :, y, x].tolist()
    return x + dx, y + dy


def constant(dx: float, dy: float) -> torch.Tensor:
    return torch.tensor([float(dx), float(dy)]).view(1, 2, 1, 1).expand(N, 2, H, W)


BOTH = pytest.mark.parametrize("warp", [reproject, reproject_bicubic])


@BOTH
def test_no_motion_is_the_identity(warp):
    warped, valid = warp(history(), None)
    assert torch.equal(warped, history())
    assert valid.all()


@pytest.mark.parametrize(("dx", "dy"), [(0, 0), (1, 0), (0, 1), (-2, 3), (5, -4), (-13, 8)])
@BOTH
def test_whole_pixel_motion_shifts_the_image(warp, dx, dy):
    warped, valid = warp(history(), constant(dx, dy))
    for y in range(H):
        for x in range(W):
            inside = 0 <= x + dx < W and 0 <= y + dy < H
            assert valid[:, 0, y, x].tolist() == [inside] * N
            if inside:
                torch.testing.assert_close(
                    warped[..., y, x], history()[..., y + dy, x + dx], atol=1e-5, rtol=0
                )


def test_bilinear_reprojection_equals_kornia():
    warped, valid = reproject(history(), motion())
    x = torch.arange(W) + motion()[:, 0]
    y = torch.arange(H)[:, None] + motion()[:, 1]
    theirs = kornia.geometry.transform.remap(history(), x, y, align_corners=True)
    assert 0.3 < valid.float().mean() < 0.95
    difference = (warped - theirs).abs().where(valid, 0.0)
    assert difference.max() < 1e-5  # float32 grid coordinates


@pytest.mark.parametrize("h", [6, 7])  # of two strips, and of one
def test_several_threads_warp_one_image_as_one_thread_does(monkeypatch, h):
    image, moved = history()[:1, :, :h], motion()[:1, :, :h]
    expected = reproject(image, moved)[0]
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    torch.testing.assert_close(reproject(image, moved)[0], expected, rtol=0, atol=1e-6)


def test_bicubic_reprojection_equals_a_loop_with_the_kernel_of_keys_and_clamping():
    def kernel(t: float) -> float:  # Keys 1981, equation 15, a of -0.75
        a, t = -0.75, abs(t)
        near = (a + 2) * t**3 - (a + 3) * t**2 + 1
        far = a * t**3 - 5 * a * t**2 + 8 * a * t - 4 * a
        return near if t <= 1 else far if t < 2 else 0.0

    warped, valid = reproject_bicubic(history(), motion())
    assert torch.equal(valid, reproject(history(), motion())[1])
    for n in range(N):
        for y, x in valid[n, 0].nonzero().tolist():
            px, py = source(n, y, x)
            left, top = math.floor(px), math.floor(py)
            summed, nearest = torch.zeros(C), []
            for j in range(top - 1, top + 3):
                for i in range(left - 1, left + 3):
                    tap = history()[n, :, min(max(j, 0), H - 1), min(max(i, 0), W - 1)]
                    summed += kernel(px - i) * kernel(py - j) * tap
                    nearest += [tap] if i in (left, left + 1) and j in (top, top + 1) else []
            least, largest = torch.stack(nearest).amin(0), torch.stack(nearest).amax(0)
            # float32 grid coordinates
            torch.testing.assert_close(
                warped[n, :, y, x], summed.clamp(least, largest), atol=1e-4, rtol=0
            )


def test_bicubic_taps_preserve_a_line_better_over_many_frames():
    """A line one pixel wide, moved back and forth by a third of a pixel, ten times."""
    line = torch.zeros(1, 1, 16, 32)
    line[..., 16] = 1.0
    remaining = []
    for warp in (reproject, reproject_bicubic):
        warped = line
        for step in range(20):
            motion = torch.tensor([(-1) ** step / 3, 0.0]).view(1, 2, 1, 1).expand(1, 2, 16, 32)
            warped, _ = warp(warped, motion)
        remaining.append(float(warped[0, 0, 8, 16]))
    assert remaining[1] > 1.5 * remaining[0]


def test_a_pixel_is_valid_if_all_taps_of_non_zero_weight_are_inside():
    valid = reproject(history(), motion())[1]
    for n in range(N):
        for y in range(H):
            for x in range(W):
                px, py = source(n, y, x)
                inside = 0 <= math.floor(px) <= math.ceil(px) < W
                inside &= 0 <= math.floor(py) <= math.ceil(py) < H
                assert bool(valid[n, 0, y, x]) == inside


def test_pixels_from_outside_get_the_fill_value():
    filled = reproject_or_fill(history(), constant(4, 0), fill_value=-1.0)
    assert (filled[..., W - 4 :] == -1).all()
    assert (filled[..., : W - 4] >= 0).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e30])
def test_nonfinite_or_huge_motion_is_invalid_and_affects_one_pixel(bad):
    vectors = constant(0, 0).clone()
    vectors[0, 1, 4, 5] = bad
    warped, valid = reproject(history(), vectors)
    assert not valid[0, 0, 4, 5]
    assert int(valid.logical_not().sum()) == 1
    assert torch.isfinite(warped).all()


def test_a_nan_in_the_history_affects_four_pixels():
    bad = history()
    bad[0, 0, 4, 5] = math.nan
    warped, _ = reproject(bad, constant(0.5, 0.5))
    assert int(warped.isnan().sum()) == 4


def test_a_half_precision_history_is_reprojected_with_float32_positions():
    """bfloat16 cannot tell the pixels 500 and 501 apart."""
    stripes = (torch.arange(720) % 2).float().expand(1, 1, 4, 720)
    warped, valid = reproject(stripes.bfloat16(), torch.zeros(1, 2, 4, 720))
    assert valid.all()
    assert warped.dtype == torch.bfloat16
    torch.testing.assert_close(warped.float(), stripes, atol=1e-3, rtol=0)
