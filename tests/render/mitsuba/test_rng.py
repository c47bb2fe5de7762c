"""Random numbers of samples."""

import itertools

import numpy as np
import pytest

from rlbench.render.mitsuba import load
from rlbench.render.mitsuba import tracer as rng


def numbers(pixels, samples, key, count):
    import drjit as dr
    import mitsuba as mi

    arrays = [load.upload(mi.UInt32, np.asarray(a)) for a in (pixels, samples)]
    source = rng.make_sampler(*arrays, [dr.opaque(mi.UInt32, k) for k in key])
    return np.stack([np.array(source.next_1d()) for _ in range(count)], axis=1)


def test_streams_times_and_seeds_never_share_a_key():
    choices = itertools.product(rng.STREAMS, (-1.0, 0.0, 0.5, 1.0), (0, 1))
    keys = [rng.stream_key(*choice) for choice in choices]
    assert len(set(keys)) == len(keys)


def test_an_unknown_stream_is_an_error_that_lists_the_available_ones():
    with pytest.raises(LookupError, match="referenceA"):
        rng.stream_key("reference", 0.0, 0)


def test_numbers_are_uniform(llvm):
    pixel, sample = np.indices((100, 100)).reshape(2, -1)
    drawn = numbers(pixel, sample, rng.stream_key("input", 0.0, 0), 4)
    counts = np.histogram(drawn, 50, (0, 1))[0]
    expected = drawn.size / 50
    assert ((counts - expected) ** 2 / expected).sum() < 49 + 4 * np.sqrt(2 * 49)  # chi2 + 4 sd


@pytest.mark.parametrize("moved", ["pixel", "sample", "dimension"])
def test_neighbours_are_uncorrelated(llvm, moved):
    pixel, sample = np.indices((100, 100)).reshape(2, -1)
    drawn = numbers(pixel, sample, rng.stream_key("input", 0.0, 0), 2).reshape(100, 100, 2)
    first, second = {
        "pixel": (drawn[1:], drawn[:-1]),
        "sample": (drawn[:, 1:], drawn[:, :-1]),
        "dimension": (drawn[..., 0], drawn[..., 1]),
    }[moved]
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 4 / np.sqrt(first.size)


@pytest.mark.parametrize("pair", itertools.combinations(rng.STREAMS, 2), ids="-".join)
def test_two_streams_share_no_number(llvm, pair):
    pixel, sample = np.indices((50, 50)).reshape(2, -1)
    a, b = (numbers(pixel, sample, rng.stream_key(s, 0.0, 0), 2) for s in pair)
    # 24-bit numbers agree by chance in one of 16 million
    assert (a == b).sum() <= 2


@pytest.mark.parametrize("other", [(2**20, 0), (0, 4096), (1, 0), (2**31, 0), (0, 2**31)])
def test_pixels_and_samples_of_any_size_have_numbers_of_their_own(llvm, other):
    first, second = numbers([0, other[0]], [0, other[1]], rng.stream_key("input", 0.0, 0), 4)
    assert (first != second).all()


def test_no_two_paths_of_any_stream_draw_the_same_numbers(llvm):
    pixel, sample = np.indices((40, 40)).reshape(2, -1)
    drawn = [numbers(pixel, sample, rng.stream_key(s, 0.0, 0), 4) for s in rng.STREAMS]
    # four numbers of 24 bits: 8000 paths agree in all by chance once in 10^21
    assert len(np.unique(np.concatenate(drawn), axis=0)) == 5 * 40 * 40
