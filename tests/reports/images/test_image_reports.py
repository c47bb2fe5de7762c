"""Reports of kept images: files as named, numbers of the run, crops and rows chosen by rule."""

from __future__ import annotations

import importlib
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
import torch

from reports.analysis.images import decibels, encode_srgb, luminance, squared_error
from reports.difference_map import draw_differences, find_difference, large_difference
from reports.sampling_maps import draw_sampling, find_samples
from reports.time_slices import find_slice, flicker
from reports.zooms import choose_crops, draw_zooms, find_zoom
from rlbench.benchmark.results import MissingRowsError
from rlbench.ops import color
from tests.reports.test_every_report import PROJECT

PAIR, ADAPTIVE = ("eaw", "mean"), "accumulate/contrast"
REPORTS = PROJECT["entry-points"]["rlbench.image_reports"]


def write(name, kept, folder, methods=PAIR):
    module = importlib.import_module(REPORTS[name].partition(":")[0])
    return module.write(kept.rows, folder, kept.clips, methods)


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_writes_a_figure_and_its_table(name, kept, tmp_path):
    files = write(name, kept, tmp_path)
    assert [file.name for file in files] == [f"{name}.{s}" for s in ("png", "pdf", "svg", "csv")]
    assert all(file.stat().st_size > 100 for file in files)
    methods = pd.read_csv(files[-1])["method"]
    assert set(methods) == ({"eaw"} if name == "difference-map" else set(PAIR))


@pytest.mark.parametrize("name", REPORTS)
def test_a_row_without_images_is_an_error_that_names_the_others(name, kept, tmp_path):
    with pytest.raises(MissingRowsError, match="no images of ours on alpha; there are: .*eaw"):
        write(name, kept, tmp_path, ["ours", "eaw"])


@pytest.mark.parametrize("find", [find_zoom, find_difference])
def test_one_row_cannot_be_compared(find, kept):
    with pytest.raises(MissingRowsError, match="2 methods with images"):
        find(kept.clips[0], ["eaw"])


def test_the_curve_of_srgb_is_that_of_the_core_and_white_has_luminance_one():
    radiance = np.linspace(0, 1, 1001, dtype=np.float32)
    expected = color.encode_srgb(torch.from_numpy(radiance)).numpy()
    assert encode_srgb(radiance) == pytest.approx(expected, abs=1e-6)
    assert luminance(np.ones((2, 3, 4, 4))) == pytest.approx(np.ones((2, 4, 4)))


def test_the_psnr_of_kept_images_is_that_of_the_run(kept):
    for clip in kept.clips:
        for image, (frame, reference) in product(clip.images, enumerate(clip.reference)):
            found = decibels(float(squared_error(image.frames[frame], reference).mean()))
            # images are kept in half floats
            assert found == pytest.approx(kept.psnr(image.method, clip.name, frame), abs=0.01)


def test_a_pixel_that_is_not_finite_has_the_largest_error():
    image = np.zeros((3, 1, 3), np.float32)
    image[:, 0, 1], image[0, 0, 2] = np.nan, np.inf
    assert squared_error(image, np.zeros_like(image)).tolist() == [[0.0, 1.0, 1.0]]


def test_crops_have_the_largest_difference_of_their_grid_and_a_typical_one_apart_from_it():
    first, second = (np.random.default_rng(seed).random((3, 60, 80)) for seed in (0, 1))

    def mean(crop):
        return abs((first - second)[crop.frame][crop.slices].mean())

    largest, usual = choose_crops(first, second)
    step = largest.side // 4
    everywhere = [
        mean(largest._replace(frame=t, top=y, left=x))
        for t in range(3)
        for y in range(0, 60 - largest.side + 1, step)
        for x in range(0, 80 - largest.side + 1, step)
    ]
    assert mean(largest) == max(everywhere)
    assert usual.frame == largest.frame
    assert max(abs(usual.top - largest.top), abs(usual.left - largest.left)) >= largest.side
    assert mean(usual) < mean(largest)
    assert choose_crops(second, first) == (largest, usual)
    largest, usual = choose_crops(first, first)  # equal images still have crops
    assert (largest.frame, largest.top, largest.left) == (0, 0, 0)
    assert usual != largest


def test_zooms_name_each_crop_and_keep_the_order_of_the_request(kept):
    zoom = find_zoom(kept.clips[0], PAIR)
    titles = [axes.get_title() for axes in draw_zooms([zoom], "2 clips").axes]
    largest, usual = zoom.crops
    assert titles[0] == f"alpha, frame {zoom.frame}: reference"
    assert titles[1:] == [
        "largest difference", *(f"{zoom.psnr(m, largest):.2f} dB" for m in PAIR),
        "median difference", *(f"{zoom.psnr(m, usual):.2f} dB" for m in PAIR),
    ]  # fmt: skip
    assert zoom.psnr("eaw") == pytest.approx(kept.psnr("eaw", "alpha", zoom.frame), abs=0.01)
    assert list(find_zoom(kept.clips[0], ["mean", ADAPTIVE]).images) == ["mean", ADAPTIVE]


def test_a_row_with_less_error_has_negative_differences(kept):
    parts = [find_difference(clip, PAIR) for clip in kept.clips]
    for part in parts:
        mse = [10 ** (-kept.psnr(method, part.clip, 0) / 10) for method in PAIR]
        assert part.values[0].mean() == pytest.approx(mse[0] - mse[1], rel=0.01)
        assert part.values.mean() < 0  # a filter of one sample has less error than the sample
    swapped = find_difference(kept.clips[0], PAIR[::-1])
    assert np.array_equal(swapped.values, -parts[0].values)
    means = parts[0].values.mean(axis=(1, 2))
    assert sorted(means).index(means[parts[0].typical_frame]) == len(means) // 2
    values = np.concatenate([part.values.ravel() for part in parts])
    assert (abs(values) > large_difference(parts)).mean() == pytest.approx(0.05, abs=0.001)
    figure = draw_differences(parts, "2 clips")
    signed = [axes.images[0] for axes in figure.axes if axes.get_title() == "eaw minus mean"]
    (limits,) = {image.get_clim() for image in signed}
    assert limits[0] == -limits[1]
    bars = next(axes for axes in figure.axes if axes.patches and axes.get_yscale() == "log")
    assert sum(bar.get_height() for bar in bars.patches) == pytest.approx(1)


def test_maps_of_samples_are_those_of_adaptive_rows_on_one_scale(kept, tmp_path):
    frames = [find_samples(clip) for clip in kept.clips]
    assert [list(frame.counts) for frame in frames] == [[ADAPTIVE]] * 2
    figure = draw_sampling(frames, "2 clips")
    for name in ("viridis", "magma"):
        images = [im for axes in figure.axes for im in axes.images if im.get_array().ndim == 2]
        limits = [image.get_clim() for image in images if image.get_cmap().name == name]
        assert len(limits) == 2
        assert len(set(limits)) == 1
    table = pd.read_csv(write("sampling-maps", kept, tmp_path, ())[-1])
    # the density of the first frame, which knows no image, is uniform and costs the same
    assert table["mean_spp"].tolist() == pytest.approx([1.0, 1.0], abs=0.01)
    assert (table["most"] > 1).all()
    uniform = replace(kept.clips[0], images=tuple(kept.clips[0].images[1:]))
    with pytest.raises(MissingRowsError, match="sample uniformly .eaw, mean."):
        find_samples(uniform)


def test_samples_that_follow_the_error_are_correlated(kept):
    frame, error = find_samples(kept.clips[0]), np.random.default_rng(0).random((48, 48))
    follows = replace(frame, counts={"a": error * 4}, errors={"a": error})
    assert follows.rank_correlation("a") == pytest.approx(1)
    uniform = replace(frame, counts={"a": np.ones((48, 48))}, errors={"a": error})
    assert np.isnan(uniform.rank_correlation("a"))


def test_a_slice_is_the_row_of_all_frames_where_flicker_differs_most(kept):
    clip = kept.clips[0]
    part = find_slice(clip, PAIR)
    images = {each.method: each.frames for each in clip.images}
    assert np.array_equal(part.images["mean"], images["mean"][:, :, part.row].swapaxes(0, 1))
    assert np.array_equal(part.reference, clip.reference[:, :, part.row].swapaxes(0, 1))
    levels = [flicker(images[name], clip.reference).mean(axis=(0, 2)) for name in PAIR]
    assert part.row == int(abs(levels[0] - levels[1]).argmax())
    steady = np.repeat(clip.reference[:1] * 0.5, 3, axis=0)  # an error that stays is no flicker
    assert flicker(steady + 0.1, steady).max() == pytest.approx(0, abs=1e-12)
