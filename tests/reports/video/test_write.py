"""Files of a video, decoded again: length, size, colours, labels, divider."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from reports.video import VideoStyle, write
from reports.video.pictures import GAP, divider_position
from reports.video.style import VideoError
from reports.video.write import write_mp4, write_webp
from tests.reports.video.conftest import FRAMES, METHODS, SIDE

ZOOM = 4
PLAIN = VideoStyle(zoom=ZOOM, labels=False)
# Both codecs round coefficients of a cosine transform, and store colour at half the resolution.
# This leaves errors of 1 to 2 of 255 in smooth parts; a wrong transfer curve or matrix leaves ten.
MAX_MEAN_ERROR = 2.5


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
def test_a_video_has_every_frame_and_the_size_of_its_panels(clip, tmp_path, suffix):
    decoded = decode(clip, tmp_path, suffix, VideoStyle(zoom=ZOOM, labels=False, repeat=1))
    assert decoded.shape == (FRAMES, ZOOM * SIDE, 3 * ZOOM * SIDE + 2 * GAP, 3)


@each_format
def test_a_frame_shows_the_kept_image_on_a_display(clip, expected, tmp_path, suffix):
    decoded = decode(clip, tmp_path, suffix, PLAIN)
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


def test_equal_images_give_equal_bytes(clip, tmp_path):
    files = [write(clip, tmp_path / name, ["webp"], PLAIN)[0] for name in "ab"]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_webp_repeats_for_ever_at_the_rate_of_the_style(clip, tmp_path):
    (file,) = write(clip, tmp_path, ["webp"], VideoStyle(fps=5))
    with Image.open(file) as image:
        image.seek(1)
        image.load()
        assert (image.info["loop"], image.info["duration"]) == (0, 200)


def test_an_mp4_plays_for_four_seconds_unless_repeats_are_named(clip, tmp_path):
    assert len(decode(clip, tmp_path, "mp4", VideoStyle(fps=4))) == 16
    assert len(decode(clip, tmp_path, "mp4", VideoStyle(fps=4, repeat=2))) == 8


def test_labels_are_above_the_images_and_leave_them_as_they_are(clip, tmp_path):
    plain = decode(clip, tmp_path, "webp", PLAIN)
    labelled = decode(clip, tmp_path, "webp", VideoStyle(zoom=ZOOM))
    line = labelled.shape[1] - plain.shape[1]
    assert line > 0
    assert np.ptp(labelled[0, :line, : ZOOM * SIDE].astype(int)) > 150  # bright text on dark
    assert np.abs(labelled[:, line:].astype(int) - plain).mean() < MAX_MEAN_ERROR


@each_format
def test_rows_are_on_their_sides_of_the_divider(clip, expected, tmp_path, suffix):
    pair, style = replace(clip, reference=None), replace(PLAIN, layout="wipe", repeat=1)
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


@each_format
def test_the_divider_is_where_its_position_says(clip, tmp_path, suffix):
    pair = replace(clip, reference=None)
    style = replace(PLAIN, layout="wipe", repeat=1)
    decoded = decode(pair, tmp_path, suffix, style)
    brightest = decoded.min(-1).mean(1).argmax(1)  # the column of the white divider
    for index in (1, 5, len(decoded) - 8):
        position = divider_position(index, len(decoded)) * ZOOM * SIDE
        assert abs(brightest[index] + 1 - position) < 1.5  # it covers two columns


def test_without_the_package_an_mp4_says_how_to_install_it(clip, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(VideoError, match=r"pip install 'rlbench\[video\]', or use --format webp"):
        write(clip, tmp_path, ["webp", "mp4"], PLAIN)
    assert list(tmp_path.iterdir()) == []
    assert write(clip, tmp_path, ["webp"], PLAIN)[0].exists()


def test_a_name_says_what_a_file_shows(clip, tmp_path):
    (file,) = write(clip, tmp_path, ["webp"], PLAIN)
    assert file.name == "alpha-1spp-mean-eaw-reference.webp"
