"""Labels fit their width."""

from __future__ import annotations

import numpy as np

from reports.video.pictures import BACKGROUND, LARGEST, SMALLEST, Label, draw_label, fit_size

SHORT, LONG = (
    Label("ours", "1 spp  22.5 dB"),
    Label("accumulate/denoised-variance", "1 spp  9.1 dB"),
)


def columns_with_text(picture):
    return np.flatnonzero((picture != BACKGROUND).any((0, 2)))


def test_the_font_is_as_large_as_the_longest_label_allows():
    assert fit_size((SHORT,), 600) == LARGEST
    assert SMALLEST < fit_size((SHORT, LONG), 300) < LARGEST


def test_both_texts_are_drawn_at_their_ends():
    picture = draw_label(SHORT, 300, 14)
    columns = columns_with_text(picture)
    assert columns[0] < 10
    assert columns[-1] > 290
    assert np.diff(columns).max() > 50  # the space between them


def test_a_title_that_is_too_long_is_cut_and_does_not_touch_the_score():
    long, alone = (columns_with_text(draw_label(label, 140, 8)) for label in (LONG, SHORT))
    score = columns_with_text(draw_label(Label("", LONG.right), 140, 8))
    assert set(score) <= set(long)
    before = [column for column in long if column < score[0]]
    assert score[0] - before[-1] >= 4
    assert len(before) > sum(column < score[0] for column in alone)


def test_the_height_is_even():
    assert {draw_label(SHORT, 99, size).shape[0] % 2 for size in range(SMALLEST, LARGEST + 1)} == {
        0
    }
