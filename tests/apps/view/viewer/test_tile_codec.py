"""Tiles: how far values are rounded, and what a slow decoder reads back."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest

from rlbench.apps.view.viewer.tiles import GROUPS, LinearScale, LogScale, encode


def values_of(scale, codes):
    """The values that a decoder gives the codes of a logarithmic scale."""
    size = np.abs(codes).astype(np.float64)
    values = scale.dark * (2 ** (size / scale.steps) - 1)
    values = np.where(size == scale.top + 1, np.inf, np.where(size > scale.top + 1, np.nan, values))
    return np.where(codes < 0, -values, values)


IMAGE = np.random.default_rng(0).lognormal(-1, 2, (3, 9, 7)).astype(np.float32)


def decode_slowly(tile):
    """A twin of the encoder, written from the definition: pixel by pixel."""
    channels, height, width = tile["shape"]
    data = zlib.decompress(base64.b64decode(tile["blob"]), -15)
    starts = np.concatenate([[0], np.cumsum(tile["groups"])])
    place = list(starts[:-1])
    escaped = iter(np.frombuffer(data[starts[-1] :], "<u4"))
    codes = np.zeros((channels, height, width), int)
    for c, y, x in np.ndindex(*codes.shape):
        left = codes[c, y, x - 1] if x else 0
        up = codes[c, y - 1, x] if y else 0
        corner = codes[c, y - 1, x - 1] if x and y else 0
        group = 4 * c + sum(abs(left - corner) + abs(up - corner) >= g for g in GROUPS)
        folded = data[place[group]]
        place[group] += 1
        folded = int(next(escaped)) if folded == 255 else folded
        residual = -(folded + 1) // 2 if folded % 2 else folded // 2
        codes[c, y, x] = sorted((left, up, left + up - corner))[1] + residual
    if channels == 3:
        codes = np.stack([codes[1] + codes[0], codes[0], codes[2] + codes[0]])
    return codes


@pytest.mark.parametrize("scale", [LogScale(8), LogScale(200), LinearScale(0.01)])
def test_a_slow_decoder_reads_the_codes_that_were_written(scale):
    assert (decode_slowly(encode(IMAGE, scale)) == scale.codes(IMAGE)).all()
    counts = np.arange(63.0).reshape(1, 9, 7) % 5
    assert (decode_slowly(encode(counts, LinearScale(1.0))) == counts).all()


@pytest.mark.parametrize("steps", [8, 16, 256])
def test_an_error_stays_below_what_the_scale_declares(steps):
    scale = LogScale(steps)
    values = np.geomspace(1e-6, 6e4, 4001) * np.array([[1], [-1]])
    error = np.abs(values_of(scale, scale.codes(values)) - values)
    assert (error <= (np.abs(values) + scale.dark) * scale.relative_error * (1 + 1e-9)).all()


def test_values_that_are_not_finite_stay_so():
    scale = LogScale(16)
    values = values_of(scale, scale.codes(np.array([np.nan, np.inf, -np.inf, 0.0], np.float32)))
    assert np.array_equal(values, [np.nan, np.inf, -np.inf, 0.0], equal_nan=True)


def test_a_smooth_image_is_smaller_than_its_noise():
    smooth = np.broadcast_to(np.linspace(0.1, 1, 64, dtype=np.float32), (3, 64, 64))
    noise = smooth * np.random.default_rng(1).lognormal(size=smooth.shape)
    sizes = [len(encode(image, LogScale(16))["blob"]) for image in (smooth, noise)]
    assert sizes[0] < sizes[1] / 3
