"""Videos: panels of kept images with labels, how long they play, and files decoded again."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rlbench.apps.view.video import VideoStyle, write
from rlbench.apps.view.video.pictures import (
    BACKGROUND,
    GAP,
    LARGEST,
    MARK,
    SLICE_GAP,
    SMALLEST,
    Label,
    divider_position,
    draw_label,
    draw_panel,
    fit_size,
    panels_of,
    pictures,
)
from rlbench.apps.view.video.style import VideoError
from rlbench.apps.view.video.write import write_mp4, write_webp
from rlbench.benchmark.cell_images import list_images
from rlbench.benchmark.clip_sources import open_source
from rlbench.benchmark.results import read
from rlbench.benchmark.shown_clips import ShownClip, at_budget, find_shown_clips
from tests.reports.kept_run import FRAMES, SIDE, run_with_images

METHODS = ("mean", "eaw")
ZOOM = 4
PLAIN = VideoStyle(zoom=ZOOM, labels=False)
# Both codecs round coefficients of a cosine transform, and store colour at half the resolution.
# This leaves errors of 1 to 2 of 255 in smooth parts; a wrong transfer curve or matrix leaves ten.
MAX_MEAN_ERROR = 2.5
SHORT = Label("ours", "1 spp  22.5 dB")
LONG = Label("accumulate/denoised-variance", "1 spp  9.1 dB")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("video")
    run_with_images(folder, METHODS, [1], cut=2, times="none")
    return folder


@pytest.fixture(scope="module")
def clip(run_folder) -> ShownClip:
    """The clip alpha with its reference."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(run_folder / "cache"))
        source = open_source(run_folder / "clips" / "alpha", "stored")
        (shown,) = find_shown_clips(run_folder / "results", [source], METHODS, [1.0], buffers=())
    return at_budget(shown, METHODS, 1.0, read(run_folder / "results"))


@pytest.fixture(scope="module")
def expected(run_folder) -> Callable[[str, int], np.ndarray]:
    """The display values of a kept image, by the formula of IEC 61966-2-1 in float64: [h w 3]."""
    images = [each for each in list_images(run_folder / "results") if each.cell.key.clip == "alpha"]
    kept = {each.cell.key.method: each for each in images}

    def display(method: str, frame: int) -> np.ndarray:
        linear = kept[method].frame(frame).image.astype(np.float64).clip(0, 1).transpose(1, 2, 0)
        curved = 1.055 * linear ** (1 / 2.4) - 0.055
        return 255 * np.where(linear <= 0.0031308, 12.92 * linear, curved)

    return display


@pytest.mark.parametrize(
    ("style", "rows", "message"),
    [
        (VideoStyle(layout="diagonal"), 2, "side-by-side or wipe"),
        (VideoStyle(layout="wipe", samples=True), 2, "with samples"),
        (VideoStyle(), 7, "at most 6"),
        (VideoStyle(titles=("a",)), 2, "--titles"),
        (VideoStyle(crop=(8, 0, 20, 10)), 1, "24 x 20 pixels"),
        (VideoStyle(crop=(0, 4, 8, 8), line=12), 1, "--slice 12: lines 4 to 11"),
    ],
)
def test_what_cannot_be_shown_says_what_can(style, rows, message):
    with pytest.raises(VideoError, match=message):
        style.check(rows, False, height=20, width=24)


def test_lengths_of_loops_passes_and_files():
    assert VideoStyle(ping_pong=True).frame_order(1) == [0]
    wipe = VideoStyle(layout="wipe", fps=8)
    assert wipe.passes(8) * 8 / wipe.fps == 4  # seconds to go and come back
    assert wipe.passes(100) == 1
    assert VideoStyle(fps=8).pictures_written(8, ["mp4", "webp"]) == 32 + 8


@pytest.fixture
def uneven(clip):
    """The clip, whose second row took 0, 1, 2, ... samples in its columns."""
    counts = np.broadcast_to(np.arange(SIDE, dtype=np.float16), (FRAMES, SIDE, SIDE))
    return replace(clip, images=(clip.images[0], replace(clip.images[1], counts=counts)))


def test_panels_are_rows_samples_of_adaptive_ones_and_reference(uneven):
    samples = panels_of(uneven, VideoStyle(samples=True))
    assert [p.title for p in samples] == ["mean", "eaw", "samples of eaw", "reference"]
    titled = panels_of(uneven, VideoStyle(titles=("noisy", "smooth"), samples=True))
    assert [p.title for p in titled] == ["noisy", "smooth", "samples of smooth", "reference"]
    brightness = samples[2].frames[0, 0].astype(float) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(brightness) > 0).all()  # more samples are brighter
    assert samples[2].remarks[0] == f"0 to {SIDE - 1} a pixel"


def test_an_image_is_the_kept_image_to_the_last_bit(clip, expected):
    for panel, method in zip(panels_of(clip, VideoStyle()), METHODS, strict=False):
        for frame in range(FRAMES):
            rounding = np.abs(panel.frames[frame] - expected(method, frame)).max()
            assert rounding <= 0.5 + 1e-3  # 1e-3: the transfer curve in single precision


def test_a_label_names_budget_and_psnr_of_the_frame_where_it_is_known(clip):
    (panel, *_) = panels_of(clip, VideoStyle())
    assert panel.remarks == [f"1 spp  {value:.1f} dB" for value in clip.images[0].psnr]
    row = replace(clip.images[0], psnr=(float("nan"),) * FRAMES)
    (panel, *_) = panels_of(replace(clip, images=(row,)), VideoStyle())
    assert panel.remarks == ["1 spp"] * FRAMES


def test_a_crop_is_that_part_of_each_image_and_a_pixel_becomes_a_square(clip):
    panels = panels_of(clip, VideoStyle())
    for panel, own in zip(panels_of(clip, VideoStyle(crop=(3, 5, 8, 6))), panels, strict=True):
        assert np.array_equal(panel.frames, own.frames[:, 5:11, 3:11])
    square = np.ones((3, 3, 1), np.uint8)
    assert np.array_equal(draw_panel(panels[0], 1, 3), np.kron(panels[0].frames[1], square))


def test_a_slice_shows_one_line_in_the_order_of_time(clip):
    y, zoom = 9, 2
    (panel, *_) = panels_of(clip, VideoStyle(crop=(0, 4, SIDE, 16), line=y))
    picture = draw_panel(panel, 2, zoom)
    gap = picture[16 * zoom : 16 * zoom + SLICE_GAP]
    assert (gap == BACKGROUND).all()
    through_time = picture[16 * zoom + SLICE_GAP :]
    step = len(through_time) // FRAMES
    inside = slice(4, -4)  # without the marks
    frames = panels_of(clip, VideoStyle())[0].frames
    for frame in range(FRAMES):
        line = frames[frame, y].repeat(zoom, axis=0)
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


def columns_with_text(picture):
    return np.flatnonzero((picture != BACKGROUND).any((0, 2)))


def test_the_font_is_as_large_as_the_longest_label_allows():
    assert fit_size((SHORT,), 600) == LARGEST
    assert SMALLEST < fit_size((SHORT, LONG), 300) < LARGEST


def test_a_title_that_is_too_long_is_cut_and_does_not_touch_the_score():
    long, alone = (columns_with_text(draw_label(label, 140, 8)) for label in (LONG, SHORT))
    score = columns_with_text(draw_label(Label("", LONG.right), 140, 8))
    assert set(score) <= set(long)
    before = [column for column in long if column < score[0]]
    assert score[0] - before[-1] >= 4
    assert len(before) > sum(column < score[0] for column in alone)


def read_webp(file: Path) -> np.ndarray:
    """All pictures of an animation [t h w 3]; equal ones in a row are stored once."""
    with Image.open(file) as image:
        pictures, times = [], []
        for index in range(image.n_frames):
            image.seek(index)
            pictures.append(np.asarray(image.convert("RGB")))
            times.append(image.info["duration"])
    return np.repeat(pictures, np.rint(np.array(times) / min(times)).astype(int), axis=0)


def read_mp4(file: Path) -> np.ndarray:
    """All pictures of a video [t h w 3]."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    rounding = ["-sws_flags", "accurate_rnd+full_chroma_int"]  # as players; without it -1 of 255
    frames = imageio_ffmpeg.read_frames(str(file), output_params=rounding)
    width, height = next(frames)["size"]
    return np.stack([np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in frames])


READERS = {"webp": read_webp, "mp4": read_mp4}
each_format = pytest.mark.parametrize("suffix", READERS)


def decode(clip, folder: Path, suffix: str, style: VideoStyle) -> np.ndarray:
    (file,) = write(clip, folder, [suffix], style)
    return READERS[suffix](file)


def shrink(picture: np.ndarray) -> np.ndarray:
    """The mean of each block of ZOOM x ZOOM pixels."""
    h, w, _ = picture.shape
    return picture.reshape(h // ZOOM, ZOOM, w // ZOOM, ZOOM, 3).mean((1, 3))


@each_format
def test_a_frame_shows_the_kept_image_on_a_display(clip, expected, tmp_path, suffix):
    decoded = decode(clip, tmp_path, suffix, replace(PLAIN, repeat=1))
    assert decoded.shape == (FRAMES, ZOOM * SIDE, 3 * ZOOM * SIDE + 2 * GAP, 3)
    assert (tmp_path / f"alpha-1spp-mean-eaw-reference.{suffix}").exists()
    for panel, method in enumerate(METHODS):
        left = panel * (ZOOM * SIDE + GAP)
        for frame in range(FRAMES):
            picture = shrink(decoded[frame, :, left : left + ZOOM * SIDE])
            error = np.abs(picture - expected(method, frame)).mean()
            assert error < MAX_MEAN_ERROR


@each_format
def test_saturated_colours_stay(tmp_path, suffix):
    colours = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [200, 100, 50], [40, 80, 160], [18, 18, 18]]
    picture = np.array([colours], np.uint8).repeat(32, 0).repeat(32, 1)
    file = tmp_path / f"colours.{suffix}"
    if suffix == "mp4":
        write_mp4(iter([picture, 255 - picture]), file, 8)
    else:
        write_webp(iter([picture, 255 - picture]), file, 8, 90)
    decoded = READERS[suffix](file)[0, 16, 16::32].astype(int)
    assert np.abs(decoded - colours).max() <= 3  # 8-bit YUV; the matrix of BT.601 is off by 20


def test_a_webp_repeats_for_ever_at_the_rate_of_the_style_and_has_equal_bytes_again(clip, tmp_path):
    file, again = (write(clip, tmp_path / name, ["webp"], VideoStyle(fps=5))[0] for name in "ab")
    assert file.read_bytes() == again.read_bytes()
    with Image.open(file) as image:
        image.seek(1)
        image.load()
        assert (image.info["loop"], image.info["duration"]) == (0, 200)


def test_an_mp4_plays_for_four_seconds_unless_repeats_are_named(clip, tmp_path):
    assert len(decode(clip, tmp_path, "mp4", replace(PLAIN, fps=4, zoom=1))) == 16
    assert len(decode(clip, tmp_path, "mp4", replace(PLAIN, fps=4, zoom=1, repeat=2))) == 8


def test_labels_are_above_the_images_and_leave_them_as_they_are(clip, tmp_path):
    plain = decode(clip, tmp_path, "webp", PLAIN)
    labelled = decode(clip, tmp_path, "webp", VideoStyle(zoom=ZOOM))
    line = labelled.shape[1] - plain.shape[1]
    assert line > 0
    assert np.ptp(labelled[0, :line, : ZOOM * SIDE].astype(int)) > 150  # bright text on dark
    assert np.abs(labelled[:, line:].astype(int) - plain).mean() < MAX_MEAN_ERROR


@each_format
def test_rows_are_on_their_sides_of_the_divider(clip, expected, tmp_path, suffix):
    pair = replace(clip, reference=clip.reference[:0])
    style = replace(PLAIN, layout="wipe", repeat=1)
    decoded = decode(pair, tmp_path, suffix, style)
    count = style.pictures(FRAMES)
    assert len(decoded) == count
    for index in (0, 4, count - 5):
        frame = index // style.steps % FRAMES
        found = shrink(decoded[index])
        errors = [np.abs(found - expected(name, frame)).mean((0, 2)) for name in METHODS]
        at = round(divider_position(index, count) * SIDE)
        assert (errors[0] < errors[1])[: at - 2].all()
        assert (errors[1] < errors[0])[at + 2 :].all()


def test_without_the_package_an_mp4_says_how_to_install_it(clip, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(VideoError, match=r"pip install 'rlbench\[video\]', or use --format webp"):
        write(clip, tmp_path, ["webp", "mp4"], PLAIN)
    assert list(tmp_path.iterdir()) == []
    assert write(clip, tmp_path, ["webp"], PLAIN)[0].exists()
