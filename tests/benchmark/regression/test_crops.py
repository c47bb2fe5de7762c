"""Crops show the square where most was lost, from stored images or computed again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.cell_images import CellImages, KeptFrame, write_images
from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.frame_images import ImagesError, frame_at, method_image
from rlbench.benchmark.regression.baseline import ScoreKey
from rlbench.benchmark.regression.comparison import BaselineDiff
from rlbench.benchmark.regression.crops import SCALE, SIDE, select_tile, write_crops
from rlbench.benchmark.run_plan import RunPlan
from rlbench.clips.stored import open_clip
from rlbench.run import run_clip
from tests.conftest import write_noise
from tests.measuring import measure_scores

DIFF = BaselineDiff(ScoreKey("mean", "foyer", 1.0), "worse", 30.0, 10.0, 0.05)


@pytest.fixture
def clip(tmp_path):
    return StoredSource(write_noise(tmp_path / "foyer", "foyer", h=80, w=100))


@pytest.fixture
def table(clip, tmp_path):
    measure_scores(RunPlan(("mean",), (clip,), (1.0,)), tmp_path / "r")
    return results.read(tmp_path / "r")


def keep(folder, index, image):
    """Store an image of the cell as `rlbench run --keep-images` does."""
    planes = np.moveaxis(np.asarray(image, np.float16), -1, 0)
    frames = [KeptFrame(planes, np.ones_like(planes[0]))] * (index + 1)
    cell = CellId(CellKey("mean", "foyer", 1.0, 0, "cpu"), "content")
    write_images(folder, cell, CellImages("path", "digest", 8, frames))


def pixels(file):
    return np.rint(255 * imread(file)[::SCALE, ::SCALE, :3]).astype(np.uint8)


def test_the_worst_frame_is_computed_again_and_cut_where_its_error_is_largest(
    clip, table, tmp_path
):
    crops = write_crops(DIFF, table, 0, [clip], tmp_path / "r", tmp_path / "crops")
    psnr = table[table["metric"] == "psnr"].set_index("frame")["value"]
    assert f"frame {psnr.idxmin()} ({psnr.min():.2f} dB)" in crops.title
    assert crops.title.endswith("computed again")
    assert list(crops.files) == ["reference", "now", "difference"]

    result = frame_at(
        run_clip(registry.load_method("mean"), open_clip(clip.folder), 1.0), psnr.idxmin()
    )
    now = method_image("mean", result).image
    reference = result.frame.reference.mean[0].movedim(0, -1).numpy()
    error = (now.srgb - np.clip(encode(reference), 0, 1)) ** 2
    sums = {
        (y, x): error[y : y + SIDE, x : x + SIDE].sum()
        for y in (0, 8, 80 - SIDE)
        for x in (0, 8, 16, 24, 32, 100 - SIDE)
    }
    y, x = max(sums, key=sums.__getitem__)
    assert f"pixels ({x}, {y}) to ({x + SIDE}, {y + SIDE})" in crops.title
    assert np.array_equal(pixels(crops.files["now"]), now.rgb8[y : y + SIDE, x : x + SIDE])


def encode(linear):
    """Slow twin of the sRGB curve: IEC 61966-2-1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_stored_images_are_shown_and_cut_where_the_error_rose(clip, table, tmp_path):
    frame = int(table[table["metric"] == "psnr"].sort_values("value")["frame"].iloc[0])
    before = np.full((80, 100, 3), 0.5)
    before[:20, :20] = 1.0  # as wrong in both: not what changed
    now = before.copy()
    now[70:78, 90:98] = 0.0
    keep(tmp_path / "r", frame, now)
    keep(tmp_path / "old", frame, before)
    folders = [tmp_path / name for name in ("r", "crops", "old")]
    crops = write_crops(DIFF, table, 0, [clip], *folders)
    assert crops.title.endswith("as stored")
    assert list(crops.files) == ["reference", "before", "now", "difference"]
    assert np.unique(pixels(crops.files["now"])).tolist() == [0, round(255 * encode(0.5))]
    assert np.unique(pixels(crops.files["before"])).tolist() == [round(255 * encode(0.5))]
    difference = pixels(crops.files["difference"]).sum(-1)
    assert (difference > difference.min()).sum() == 64  # the changed square, and no other pixel


def test_without_its_clip_or_weights_a_frame_has_no_crops(clip, table, tmp_path):
    with pytest.raises(ImagesError, match="clip foyer is not here. Name its folder by --clips"):
        write_crops(DIFF, table, 0, [], tmp_path / "r", tmp_path / "crops")
    with pytest.raises(ImagesError, match="Store its images: rlbench run --keep-images"):
        write_labelled("mean@seed3", clip, table, tmp_path)
    assert not (tmp_path / "crops").exists()
    crops = write_labelled("mean@tiles", clip, table, tmp_path)
    assert crops.title.startswith("mean@tiles")
    assert crops.title.endswith("computed again")


def write_labelled(name, clip, table, folder):
    diff, labelled = replace(DIFF, key=DIFF.key._replace(method=name)), table.assign(method=name)
    return write_crops(diff, labelled, 0, [clip], folder / "r", folder / "crops")


@pytest.mark.parametrize("size", [(20, 24), (64, 64), (65, 300)])
def test_a_tile_lies_inside_the_image(size):
    rng = np.random.default_rng(size)
    rows, columns = select_tile(rng.random(size))
    assert 0 <= rows.start < rows.stop <= size[0]
    assert 0 <= columns.start < columns.stop <= size[1]
    assert rows.stop - rows.start == columns.stop - columns.start == min(SIDE, *size)
