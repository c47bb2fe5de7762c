"""Reports of kept images: files as named, numbers of the run, crops and rows chosen by rule."""

from __future__ import annotations

import importlib
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
import torch

from reports.analysis.images import decibels, encode_srgb, squared_error
from reports.zooms import choose_crops, draw_zooms, find_zoom
from rlbench.benchmark.results import MissingRowsError, read
from rlbench.benchmark.shown_clips import ShownClip
from rlbench.cli.selection import find_images
from rlbench.ops import color
from tests.reports.kept_run import run_with_images
from tests.reports.test_every_report import PROJECT

PAIR, ADAPTIVE = ("eaw", "mean"), "accumulate/contrast"
REPORTS = PROJECT["entry-points"]["rlbench.image_reports"]


class Kept(NamedTuple):
    """The rows of the run, and its clips with their images at 1 spp."""

    rows: pd.DataFrame
    clips: list[ShownClip]

    def psnr(self, method: str, clip: str, frame: int) -> float:
        """The score that the run stored."""
        rows = self.rows[self.rows["metric"] == "psnr"].set_index(["method", "clip", "frame"])
        return rows.loc[(method, clip, frame), "value"].item()


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Kept:
    folder = tmp_path_factory.mktemp("kept")
    run_with_images(folder, (ADAPTIVE, *PAIR), [1], cut=2, times="none")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(folder / "cache"))
        rows = read(folder / "results")
        return Kept(rows, list(find_images(folder / "results", rows, [folder / "clips"])[0]))


def write(name, kept, folder, methods=PAIR):
    module = importlib.import_module(REPORTS[name].partition(":")[0])
    return module.write(kept.rows, folder, kept.clips, methods)


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_writes_a_figure_and_its_table(name, kept, tmp_path):
    files = write(name, kept, tmp_path)
    assert [file.name for file in files] == [f"{name}.{s}" for s in ("png", "pdf", "svg", "csv")]
    assert all(file.stat().st_size > 100 for file in files)
    assert set(pd.read_csv(files[-1])["method"]) == set(PAIR)


@pytest.mark.parametrize("name", REPORTS)
def test_a_row_without_images_is_an_error_that_names_the_others(name, kept, tmp_path):
    with pytest.raises(MissingRowsError, match="no images of ours on alpha; there are: .*eaw"):
        write(name, kept, tmp_path, ["ours", "eaw"])


def test_one_row_cannot_be_compared(kept):
    with pytest.raises(MissingRowsError, match="2 methods with images"):
        find_zoom(kept.clips[0], ["eaw"])


def test_the_curve_of_srgb_is_that_of_the_core():
    radiance = np.linspace(0, 1, 1001, dtype=np.float32)
    expected = color.encode_srgb(torch.from_numpy(radiance)).numpy()
    assert encode_srgb(radiance) == pytest.approx(expected, abs=1e-6)


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
