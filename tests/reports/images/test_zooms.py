"""The figure of crops: numbers of the run, rows in the order of the request."""

from __future__ import annotations

import pandas as pd
import pytest
from matplotlib.image import imread

from reports import zooms
from rlbench.benchmark.results import MissingRowsError

PAIR = ("eaw", "mean")


@pytest.fixture(scope="module")
def files(kept, tmp_path_factory):
    return zooms.write(kept.rows, tmp_path_factory.mktemp("zooms"), kept.clips, PAIR)


def test_a_figure_and_a_table_are_written(files):
    assert [file.name for file in files] == [f"zooms.{s}" for s in ("png", "pdf", "svg", "csv")]
    assert imread(files[0]).shape[1] == 1950  # 13 inches at 150 dpi


def test_the_psnr_of_a_frame_is_that_of_the_run(kept, files):
    for row in pd.read_csv(files[-1]).to_dict("records"):
        stored = kept.psnr(row["method"], row["clip"], row["frame"])
        assert row["frame_psnr"] == pytest.approx(stored, abs=0.01)


def test_each_crop_is_named_above_its_picture(kept):
    zoom = zooms.find_zoom(kept.clips[0], PAIR)
    figure = zooms.draw_zooms([zoom], "2 clips")
    titles = [axes.get_title() for axes in figure.axes]
    largest, usual = zoom.crops
    assert titles[0] == f"alpha, frame {zoom.frame}: reference"
    assert titles[1:] == [
        "largest difference", *(f"{zoom.psnr(m, largest):.2f} dB" for m in PAIR),
        "median difference", *(f"{zoom.psnr(m, usual):.2f} dB" for m in PAIR),
    ]  # fmt: skip


def test_rows_are_in_the_order_of_the_request(kept):
    zoom = zooms.find_zoom(kept.clips[0], ["mean", "accumulate/contrast"])
    assert list(zoom.images) == ["mean", "accumulate/contrast"]


def test_a_row_without_images_is_an_error_that_names_the_others(kept):
    with pytest.raises(MissingRowsError, match="no images of ours on alpha; there are: .*eaw"):
        zooms.find_zoom(kept.clips[0], ["ours", "eaw"])


def test_one_row_cannot_be_compared(kept):
    with pytest.raises(MissingRowsError, match="2 methods with images are compared"):
        zooms.find_zoom(kept.clips[0], ["eaw"])


def test_equal_results_give_equal_files(kept, files, tmp_path):
    again = zooms.write(kept.rows, tmp_path, kept.clips, PAIR)
    assert [file.read_bytes() for file in files] == [file.read_bytes() for file in again]
