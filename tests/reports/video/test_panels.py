"""What the panels of a clip show: kept images, samples of adaptive rows, a line through time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from reports.video.pictures import BACKGROUND, MARK, SLICE_GAP, draw_panel, panels_of, pictures
from reports.video.style import VideoStyle
from tests.reports.video.conftest import FRAMES, METHODS, SIDE


@pytest.fixture
def uneven(clip):
    """The clip, whose second row took 0, 1, 2, ... samples in its columns."""
    counts = np.broadcast_to(np.arange(SIDE, dtype=np.float16), (FRAMES, SIDE, SIDE))
    return replace(clip, rows=(clip.rows[0], replace(clip.rows[1], counts=counts)))


def test_panels_are_rows_and_reference(clip):
    assert [panel.title for panel in panels_of(clip, VideoStyle())] == [*METHODS, "reference"]


def test_an_image_is_the_kept_image_to_the_last_bit(clip, expected):
    for panel, method in zip(panels_of(clip, VideoStyle()), METHODS, strict=False):
        for frame in range(FRAMES):
            rounding = np.abs(panel.frames[frame] - expected(method, frame)).max()
            assert rounding <= 0.5 + 1e-3  # 1e-3: the transfer curve in single precision


def test_a_label_names_budget_and_psnr_of_the_frame(clip):
    (panel, *_) = panels_of(clip, VideoStyle())
    psnr = clip.rows[0].psnr
    assert len(set(psnr)) > 1
    assert panel.remarks == [f"1 spp  {value:.1f} dB" for value in psnr]


def test_a_frame_without_psnr_has_its_budget_alone(clip):
    row = replace(clip.rows[0], psnr=(float("nan"),) * FRAMES)
    (panel, *_) = panels_of(replace(clip, rows=(row,)), VideoStyle())
    assert panel.remarks == ["1 spp"] * FRAMES


def test_titles_replace_names(uneven):
    panels = panels_of(uneven, VideoStyle(titles=("noisy", "smooth"), samples=True))
    assert [p.title for p in panels] == ["noisy", "smooth", "samples of smooth", "reference"]


def test_the_samples_of_adaptive_rows_alone_are_shown(uneven):
    titles = [panel.title for panel in panels_of(uneven, VideoStyle(samples=True))]
    assert titles == ["mean", "eaw", "samples of eaw", "reference"]


def test_more_samples_are_brighter(uneven):
    samples = panels_of(uneven, VideoStyle(samples=True))[2]
    brightness = samples.frames[0, 0].astype(float) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(brightness) > 0).all()
    assert samples.remarks[0] == f"0 to {SIDE - 1} a pixel"


def test_a_crop_is_that_part_of_each_image(clip):
    for panel, own in zip(
        panels_of(clip, VideoStyle(crop=(3, 5, 8, 6))), panels_of(clip, VideoStyle()), strict=True
    ):
        assert np.array_equal(panel.frames, own.frames[:, 5:11, 3:11])


def test_a_pixel_becomes_a_square(clip):
    (panel, *_) = panels_of(clip, VideoStyle())
    square = np.ones((3, 3, 1), np.uint8)
    assert np.array_equal(draw_panel(panel, 1, 3), np.kron(panel.frames[1], square))


def test_a_slice_shows_one_line_in_the_order_of_time(clip):
    y, zoom = 9, 2
    (panel, *_) = panels_of(clip, VideoStyle(crop=(0, 4, SIDE, 16), line=y))
    picture = draw_panel(panel, 2, zoom)
    gap = picture[16 * zoom : 16 * zoom + SLICE_GAP]
    assert (gap == BACKGROUND).all()
    through_time = picture[16 * zoom + SLICE_GAP :]
    step = len(through_time) // FRAMES
    inside = slice(4, -4)  # without the marks
    for frame in range(FRAMES):
        line = clip.rows[0].frames[frame, y].repeat(zoom, axis=0)
        assert np.array_equal(through_time[frame * step, inside], line[inside])
    assert (through_time[2 * step : 3 * step, :2] == MARK).all()
    assert (picture[(y - 4) * zoom, :2] == MARK).all()


@pytest.mark.parametrize("layout", ["side-by-side", "wipe"])
def test_pictures_have_even_sizes(clip, layout):
    style = VideoStyle(layout=layout, crop=(0, 0, 7, 5), labels=False)
    sizes = {picture.shape for picture in pictures(panels_of(clip, style)[:2], style)}
    assert all(h % 2 == w % 2 == 0 for h, w, _ in sizes)
    assert len(sizes) == 1


def test_columns_put_images_below_each_other(clip):
    panels = panels_of(clip, VideoStyle())
    style = VideoStyle(columns=2, labels=False)
    picture = next(pictures(panels, style))
    assert np.array_equal(picture[:SIDE, :SIDE], panels[0].frames[0])
    assert np.array_equal(picture[-SIDE:, :SIDE], panels[2].frames[0])
    assert (picture[-SIDE:, -SIDE:] == BACKGROUND).all()
