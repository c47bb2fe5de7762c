"""Crops are chosen by rule: the largest difference, and the median of the same frame."""

from __future__ import annotations

import numpy as np

from reports.zooms import choose_crops


def errors(seed=0):
    return np.random.default_rng(seed).random((3, 60, 80))


def means(difference, crop):
    return abs(difference[crop.frame][crop.slices].mean())


def test_no_crop_on_its_grid_has_a_larger_difference_than_the_first():
    first, second = errors(0), errors(1)
    largest, _ = choose_crops(first, second)
    step = largest.side // 4
    everywhere = [
        means(first - second, largest._replace(frame=t, top=y, left=x))
        for t in range(3)
        for y in range(0, 60 - largest.side + 1, step)
        for x in range(0, 80 - largest.side + 1, step)
    ]
    assert means(first - second, largest) == max(everywhere)


def test_the_second_crop_is_typical_and_does_not_touch_the_first():
    first, second = errors(0), errors(1)
    largest, usual = choose_crops(first, second)
    assert usual.frame == largest.frame
    apart = abs(usual.top - largest.top), abs(usual.left - largest.left)
    assert max(apart) >= largest.side
    assert means(first - second, usual) < means(first - second, largest)


def test_the_order_of_two_images_does_not_matter():
    assert choose_crops(errors(0), errors(1)) == choose_crops(errors(1), errors(0))


def test_equal_images_still_have_crops():
    largest, usual = choose_crops(errors(0), errors(0))
    assert (largest.frame, largest.top, largest.left) == (0, 0, 0)
    assert usual != largest
