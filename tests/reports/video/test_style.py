"""A style says what it cannot show, and how long it takes."""

from __future__ import annotations

import pytest

from reports.video.pictures import divider_position
from reports.video.style import VideoError, VideoStyle, check_formats


@pytest.mark.parametrize(
    ("style", "rows", "message"),
    [
        (VideoStyle(layout="diagonal"), 2, "no such layout; use side-by-side or wipe"),
        (VideoStyle(layout="wipe"), 3, "a wipe shows two images, and 3 are selected"),
        (VideoStyle(layout="wipe", samples=True), 2, "2 are selected with samples"),
        (VideoStyle(), 7, "7 images are selected, and a video shows at most 6"),
        (VideoStyle(titles=("a",)), 2, "--titles has 1 titles for 2 rows"),
        (VideoStyle(crop=(8, 0, 20, 10)), 1, "no part of frames of 24 x 20 pixels"),
        (VideoStyle(crop=(0, 4, 8, 8), line=12), 1, "--slice 12: lines 4 to 11 are shown"),
        (VideoStyle(line=20), 1, "--slice 20: lines 0 to 19 are shown"),
    ],
)
def test_what_cannot_be_shown_says_what_can(style, rows, message):
    with pytest.raises(VideoError, match=message):
        style.check(rows, False, height=20, width=24)


def test_an_unknown_format_names_the_known_ones():
    with pytest.raises(VideoError, match="--format gif: no such format; use mp4, webp"):
        check_formats(["webp", "gif"])


def test_ping_pong_shows_the_ends_once():
    assert VideoStyle(ping_pong=True).frame_order(4) == [0, 1, 2, 3, 2, 1]
    assert VideoStyle(ping_pong=True).frame_order(1) == [0]


def test_a_divider_has_four_seconds_to_go_and_come_back():
    style = VideoStyle(layout="wipe", fps=8)
    assert style.passes(8) * 8 / style.fps == 4
    assert style.passes(100) == 1


def test_a_divider_ends_where_it_started():
    positions = [divider_position(index, 24) for index in range(24)]
    assert (min(positions), max(positions)) == (0, 1)
    steps = [abs(b - a) for a, b in zip(positions, positions[1:] + positions[:1], strict=True)]
    assert max(steps) < 0.14
    assert positions[0] == 0.5


def test_pictures_of_all_files_are_counted():
    style = VideoStyle(fps=8)
    assert style.pictures_written(8, ["webp"]) == 8
    assert style.pictures_written(8, ["mp4", "webp"]) == 32 + 8
