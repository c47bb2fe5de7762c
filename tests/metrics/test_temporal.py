"""Temporal metrics: equal to slow twins and closed forms; steady errors are free."""

from __future__ import annotations

import math

import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio

from metrics.catalog import PSNR, TPSNR
from metrics.catalog_video import DRIFT, FLICKER, IMAGE_FLICKER, PSNR_LATE, WARPED_ERROR, drift
from metrics.display import encode_display
from metrics.metric import Comparison
from metrics.temporal import (
    MIN_WEIGHT,
    change_of_error,
    flicker,
    locate_previous,
    warp,
    warped_error,
)
from rlbench.ops.reprojection import reproject

SIZE = (1, 3, 9, 12)


def random_error(seed, size=SIZE, scale=0.2):
    return scale * torch.randn(size, generator=torch.Generator().manual_seed(seed))


def random_motion(seed, reach=4.0, size=SIZE):
    uniform = torch.rand(size[0], 2, *size[2:], generator=torch.Generator().manual_seed(seed))
    return reach * (2 * uniform - 1)


def bilinear(image, x, y):
    """One position of an image [3 h w] by the four taps; None outside."""
    h, w = image.shape[1:]
    if not (0 <= x <= w - 1 and 0 <= y <= h - 1):
        return None
    left, top = min(int(x), w - 2), min(int(y), h - 2)
    fx, fy = x - left, y - top
    return (
        (1 - fx) * (1 - fy) * image[:, top, left]
        + fx * (1 - fy) * image[:, top, left + 1]
        + (1 - fx) * fy * image[:, top + 1, left]
        + fx * fy * image[:, top + 1, left + 1]
    )


def changes_by_loops(error, previous, motion):
    """Change of the error at each pixel (row, column) whose motion stays inside."""
    found = {}
    for row in range(error.shape[2]):
        for column in range(error.shape[3]):
            dx, dy = motion[0, :, row, column].tolist()
            before = bilinear(previous[0], column + dx, row + dy)
            if before is not None:
                found[row, column] = error[0, :, row, column] - before
    return found


def change_along(error, previous, motion):
    return change_of_error(error, previous, locate_previous(error, motion))


def percent(changes):
    return 100 * torch.stack(list(changes)).double().square().mean().sqrt().item()


def flicker_by_loops(errors, motions):
    """Flicker of three frames of errors, oldest first; pixels that read no change are out."""
    older = changes_by_loops(errors[1], errors[0], motions[0])
    newer = changes_by_loops(errors[2], errors[1], motions[1])
    image, unknown = torch.zeros(errors[0].shape[1:]), torch.ones(1, *errors[0].shape[2:])
    for (row, column), change in older.items():
        image[:, row, column], unknown[:, row, column] = change, 0.0
    seconds = []
    for (row, column), change in newer.items():
        dx, dy = motions[1][0, :, row, column].tolist()
        if bilinear(unknown, column + dx, row + dy) <= MIN_WEIGHT:
            seconds.append(change - bilinear(image, column + dx, row + dy))
    return percent(seconds) / math.sqrt(6)


def test_warp_equals_the_reprojection_that_methods_use():
    values, motion = random_error(0), random_motion(1)
    moved, is_inside = warp(values, motion)
    expected, valid = reproject(values, motion)
    assert torch.equal(is_inside, valid)
    torch.testing.assert_close(moved * valid, expected * valid, atol=1e-6, rtol=1e-5)


def test_warped_error_equals_a_loop_over_pixels():
    error, previous, motion = random_error(0), random_error(1), random_motion(2)
    score = warped_error(change_along(error, previous, motion)).item()
    by_loops = changes_by_loops(error, previous, motion)
    assert 20 < len(by_loops) < 9 * 12  # some pixels leave the image
    assert score == pytest.approx(percent(by_loops.values()), rel=1e-4)  # float32 positions


def test_flicker_equals_a_loop_over_pixels():
    errors, motions = [random_error(i) for i in range(3)], [random_motion(5), random_motion(6)]
    steps = [change_along(errors[i + 1], errors[i], motions[i]) for i in (0, 1)]
    score = flicker(steps[1], steps[0]).item()
    assert score == pytest.approx(flicker_by_loops(errors, motions), rel=1e-3)  # twice warped


def test_image_flicker_is_that_of_the_images_and_needs_no_reference():
    images = [random_error(i).abs().clamp(0, 1) for i in range(3)]
    motions = [random_motion(4), random_motion(5), random_motion(6)]
    frame = None
    for image, motion in zip(images, motions, strict=True):
        lacking = torch.full_like(image, math.nan)
        frame = Comparison.of(image, lacking, lacking, motion=motion, previous=frame)
    displayed = [encode_display(image) for image in images]
    expected = flicker_by_loops(displayed, motions[1:])
    assert IMAGE_FLICKER.score(frame).item() == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("shift", [(2, 0), (-3, 1)])
def test_an_image_that_moves_as_the_motion_says_has_no_warped_error(shift):
    texture = torch.rand(SIZE, generator=torch.Generator().manual_seed(0))
    motion = torch.tensor(shift).float().view(1, 2, 1, 1).expand(1, 2, *SIZE[2:])
    reference = torch.full(SIZE, 0.5)
    frame = Comparison.of(texture, reference, reference)
    for _ in range(2):
        moved = frame.image.roll((-shift[1], -shift[0]), (2, 3))
        frame = Comparison.of(moved, reference, reference, motion=motion, previous=frame)
    assert WARPED_ERROR.score(frame).item() == pytest.approx(0, abs=1e-3)  # float32 positions
    assert FLICKER.score(frame).item() == pytest.approx(0, abs=1e-3)
    assert TPSNR.score(frame).item() < 20  # which does not follow the motion


def test_what_the_reference_does_too_is_no_error():
    frame, generator = None, torch.Generator().manual_seed(1)
    for _ in range(3):
        image = torch.rand(SIZE, generator=generator)
        frame = Comparison.of(image, image, image, motion=random_motion(3), previous=frame)
    assert WARPED_ERROR.score(frame).item() == FLICKER.score(frame).item() == 0


def test_a_constant_error_and_an_even_drift_do_not_flicker():
    errors = [0.1 + random_error(0) + 0.05 * t for t in range(3)]
    steps = [change_along(b, a, None) for a, b in zip(errors, errors[1:], strict=False)]
    assert flicker(steps[1], steps[0]).item() == pytest.approx(0, abs=1e-4)
    assert warped_error(steps[1]).item() == pytest.approx(5, abs=1e-4)


@pytest.mark.parametrize("sigma", [0.01, 0.1])
def test_independent_errors_flicker_by_their_standard_deviation(sigma):
    errors = [random_error(i, (1, 3, 96, 96), sigma) for i in range(3)]
    steps = [change_along(b, a, None) for a, b in zip(errors, errors[1:], strict=False)]
    # 27648 numbers: the standard deviation of a standard deviation is 0.4 %
    assert flicker(steps[1], steps[0]).item() == pytest.approx(100 * sigma, rel=0.02)
    assert warped_error(steps[1]).item() == pytest.approx(100 * math.sqrt(2) * sigma, rel=0.02)


def test_a_frame_whose_motion_leaves_the_image_everywhere_has_no_score():
    outside = torch.full((1, 2, *SIZE[2:]), 100.0)
    cut = change_along(random_error(1), random_error(0), outside)
    broken = change_along(random_error(1) * math.nan, random_error(0), outside)
    after = change_along(random_error(2), random_error(1), None)
    assert warped_error(cut).isnan()
    assert warped_error(broken).isnan()  # or methods would be averaged over different frames
    assert flicker(cut, after).isnan()
    assert flicker(after, cut).isnan()
    assert warped_error(after).isfinite()


def test_a_nonfinite_pixel_changes_by_the_most_that_a_display_can_show():
    error = torch.zeros(SIZE)
    broken = error.clone()
    broken[0, :, 4, 5] = math.nan
    pixels = SIZE[2] * SIZE[3]
    for now, before in ((broken, error), (error, broken), (broken, broken)):
        step = change_along(now, before, None)
        assert warped_error(step).item() == pytest.approx(100 * math.sqrt(4 / pixels))
        steady = change_along(before, before, None)
        assert flicker(step, steady).item() == pytest.approx(100 * math.sqrt(16 / 6 / pixels))


def test_a_nonfinite_pixel_counts_where_its_motion_leaves_the_image():
    motion = torch.zeros(1, 2, *SIZE[2:])
    motion[:, 0, :, 0] = -1.0  # the left column enters
    broken = torch.zeros(SIZE)
    broken[0, :, 3, 0] = math.nan
    inside = SIZE[2] * (SIZE[3] - 1)
    score = warped_error(change_along(broken, torch.zeros(SIZE), motion)).item()
    assert score == pytest.approx(100 * math.sqrt(4 / (inside + 1)))


def test_a_nonfinite_pixel_does_not_spread_to_neighbours_that_do_not_read_it():
    motion = torch.full((1, 2, *SIZE[2:]), 1.0)
    previous = torch.zeros(SIZE)
    previous[0, :, 4, 5] = math.nan
    change = change_along(torch.zeros(SIZE), previous, motion).change
    assert change.isnan().any(1).nonzero().tolist() == [[0, 3, 4]]


def test_tpsnr_equals_the_psnr_of_changes_by_scikit_image():
    images, truths = (
        1.5 * torch.rand(2, 2, 3, 20, 24, generator=torch.Generator().manual_seed(i))
        for i in (0, 1)
    )
    before = Comparison.of(images[0], truths[0], truths[0])
    scores = TPSNR.score(Comparison.of(images[1], truths[1], truths[1], previous=before))
    for n, score in enumerate(scores.tolist()):
        changes = [
            (encode_display(x[1, n].double()) - encode_display(x[0, n].double())).numpy()
            for x in (truths, images)
        ]
        expected = peak_signal_noise_ratio(*changes, data_range=1.0)
        assert score == pytest.approx(expected, abs=1e-4)  # float32


@pytest.mark.parametrize("frame", [0, 1])
def test_a_nonfinite_pixel_has_the_largest_temporal_error(frame):
    images, grey = torch.full((2, 1, 3, 4, 5), 0.5), torch.full((1, 3, 4, 5), 0.5)
    images[frame, 0, 1, 2, 3] = torch.nan
    before = Comparison.of(images[0], grey, grey)
    score = TPSNR.score(Comparison.of(images[1], grey, grey, previous=before)).item()
    assert score == pytest.approx(-10 * math.log10(4 / 20), abs=1e-4)


def test_a_late_frame_is_scored_as_the_image_of_the_frame_before():
    random = torch.Generator().manual_seed(3)
    images, references = torch.rand(2, 2, 1, 3, 9, 11, generator=random)
    frames = [Comparison.of(x, r, r) for x, r in zip(images, references, strict=True)]
    late = Comparison.of(images[1], references[1], references[1], previous=frames[0])
    as_shown = Comparison.of(images[0], references[1], references[1])
    assert PSNR_LATE.score(late).tolist() == PSNR.score(as_shown).tolist()


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([20.0] * 24, 0.0),
        ([20.0] * 6 + [30.0] * 12 + [19.0, 19.0, 19.0, 17.0, 17.0, 17.0], -2.0),
        ([20.0, 25.0], 5.0),  # a quarter has at least one frame
        ([math.nan, 25.0, 25.0, 25.0], math.nan),
    ],
)
def test_drift_is_the_last_quarter_less_the_first(scores, expected):
    assert drift(scores) == pytest.approx(expected, nan_ok=True)


def test_frames_and_their_psnr_give_the_same_drift():
    right = torch.full((1, 3, 16, 16), 0.5)
    errors = [random_error(frame, right.shape, 0.1 + 0.02 * frame) for frame in range(8)]
    frames = [DRIFT.compare(right + error, right, right) for error in errors]
    by_frame = [float(PSNR.score(frame)[0]) for frame in frames]
    assert float(DRIFT.score(frames)) == pytest.approx(drift(by_frame))
    assert drift(by_frame) < 0
