"""Images made elsewhere: they score as the method that made them, and say what nobody checked."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from rlbench.apps.dumps.foreign_images import (
    Claim,
    ForeignImagesError,
    find_foreign_images,
    score_foreign_images,
)
from rlbench.benchmark import results as table
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.frame_images import save_png
from rlbench.benchmark.runner import measure
from rlbench.clips.exr import write_exr
from rlbench.clips.pfm import read_pfm, write_pfm
from rlbench.clips.stored import open_clip
from tests.apps.dumps.exr_files import write_image
from tests.apps.dumps.importers.sources import display_bytes
from tests.benchmark.test_runner import run_plan
from tests.conftest import write_noise


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> Path:
    """A clip, and the results of a method that spreads samples unevenly, with its images."""
    folder = tmp_path_factory.mktemp("measured")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(folder / "cache"))
        plan = run_plan(write_noise(folder / "noise", exposure=0.5), "mean", "eaw")
        measure(plan, folder / "r", keep_images=True, times="none")
    return folder


@pytest.fixture
def clip(measured) -> StoredSource:
    return StoredSource(measured / "noise")


def score(clip: StoredSource, folder: Path, out: Path, claim: Claim, counts: Path | None = None):
    return score_foreign_images(claim, find_foreign_images(folder, [clip], counts), out)


def rows_of(folder: Path, method: str):
    rows = table.read(folder)
    rows = rows[(rows["method"] == method) & (rows["unit"] != "ms")]
    return rows.set_index(["metric", "frame"]).sort_index()


def write_images(clip: StoredSource, folder: Path, suffix: str = ".exr", scale: float = 1) -> Path:
    """The reference of each frame, times `scale`, in files of one kind."""
    folder.mkdir(parents=True)
    writers = {".pfm": write_pfm, ".exr": write_image}
    for frame in open_clip(clip.folder):
        image = frame.reference.mean[0].movedim(0, -1).numpy() * scale
        file = folder / f"beauty_v2.{frame.index + 7}{suffix}"
        if suffix == ".png":
            save_png(display_bytes(image), file)
        else:
            writers[suffix](file, image / clip.header.exposure)
    return folder


@pytest.mark.parametrize("counted", [True, False])
def test_kept_images_of_a_method_have_the_scores_of_its_own_row(measured, clip, tmp_path, counted):
    (folder,) = (measured / "r" / "images").glob("eaw noise 1spp*")
    claim = Claim("theirs", 1.0, is_exposed=True)
    (done,) = score(clip, folder, tmp_path / "r", claim, folder if counted else None)
    own, theirs = rows_of(measured / "r", "eaw"), rows_of(tmp_path / "r", "theirs")
    expected = own.loc["psnr", "value"]
    assert theirs.loc["psnr", "value"].to_numpy() == pytest.approx(expected.to_numpy(), abs=0.01)
    assert done.psnr == pytest.approx(expected.mean(), abs=0.01)
    assert set(theirs["mean_spp"]) == {1.0}
    of_counts = theirs.loc["effort_error"]
    assert of_counts["value"].notna().all() == counted
    assert ("pixels_with_1" in theirs.index) == counted
    assert theirs.loc["psnr", "note"].str.startswith("not verified").all()
    assert theirs["code_hash"].str.startswith("images ").all()


@pytest.mark.parametrize("suffix", [".exr", ".pfm", ".png"])
def test_each_kind_of_file_is_read_in_its_own_units(clip, tmp_path, suffix):
    folder = write_images(clip, tmp_path / "images" / "noise", suffix)
    (done,) = score(clip, folder.parent, tmp_path / "r", Claim("truth", 1.0))
    assert done.psnr >= (55 if suffix == ".png" else 99.9)  # 8 bits: an error of 1/510 at most
    (config,) = {json.loads(each)["encoding"] for each in table.read(tmp_path / "r")["config"]}
    assert config.startswith(suffix[1:].upper())


def test_a_pfm_has_its_rows_from_the_bottom_and_both_byte_orders(tmp_path):
    image = np.arange(2 * 3 * 3, dtype=np.float32).reshape(2, 3, 3)
    write_pfm(tmp_path / "a.pfm", image)
    content = (tmp_path / "a.pfm").read_bytes()
    assert content == b"PF\n3 2\n-1.0\n" + image[1].tobytes() + image[0].tobytes()
    (tmp_path / "b.pfm").write_bytes(b"PF\n3 2\n1.0\n" + image[::-1].astype(">f4").tobytes())
    for name in "ab":
        assert np.array_equal(read_pfm(tmp_path / f"{name}.pfm"), image)


def test_the_same_images_are_not_scored_again_and_others_replace_them(clip, tmp_path):
    claim = Claim("theirs", 1.0)
    bright = write_images(clip, tmp_path / "bright", scale=1.5)
    truth = write_images(clip, tmp_path / "truth")
    found = [score(clip, each, tmp_path / "r", claim)[0] for each in (bright, bright, truth)]
    assert [each.is_cached for each in found] == [False, True, False]
    assert found[0].psnr == found[1].psnr < 20 < found[2].psnr
    assert rows_of(tmp_path / "r", "theirs").loc["psnr", "value"].mean() == found[2].psnr


def test_pixels_that_are_not_finite_are_counted(clip, tmp_path):
    folder = write_images(clip, tmp_path / "images", ".pfm")
    image = read_pfm(folder / "beauty_v2.7.pfm")
    image[2, 3] = np.nan
    write_pfm(folder / "beauty_v2.7.pfm", image)
    (done,) = score(clip, folder, tmp_path / "r", Claim("theirs", 1.0))
    assert "1 pixels are NaN" in done.remarks[0]
    assert rows_of(tmp_path / "r", "theirs").loc[("nonfinite", 0), "value"] == 1


TINY = dict.fromkeys("RGB", np.zeros((4, 4), np.float32))


@pytest.mark.parametrize(
    ("damage", "found"),
    [
        (lambda file: file.unlink(), "missing: 8"),
        (lambda file: write_exr(file, TINY), "4 x 4 pixels"),
        (lambda file: file.with_suffix(".png").touch(), ".exr and .png"),
        (lambda file: file.write_bytes(b"v/1\x01"), "beauty_v2.8.exr"),
        (lambda file: shutil.copy(file, file.with_stem("albedo_v2.8")), "not numbered by frame"),
    ],
)
def test_images_that_do_not_fit_the_clip_are_named(clip, tmp_path, damage, found):
    folder = write_images(clip, tmp_path / "images")
    damage(folder / "beauty_v2.8.exr")
    with pytest.raises(ForeignImagesError, match=found):
        score(clip, folder, tmp_path / "r", Claim("theirs", 1.0))


@pytest.mark.parametrize(
    ("counts", "found"),
    [
        (np.full((20, 24), 2), "2 samples per pixel"),
        (np.full((20, 24), 0.5), "whole numbers"),
        (np.ones((2, 2)), "shape"),
    ],
)
def test_counts_that_contradict_the_claim_are_refused(clip, tmp_path, counts, found):
    folder = write_images(clip, tmp_path / "images")
    (tmp_path / "counts").mkdir()
    for index in range(3):
        np.save(tmp_path / "counts" / f"{index}.npy", counts)
    with pytest.raises(ForeignImagesError, match=found):
        score(clip, folder, tmp_path / "r", Claim("theirs", 1.0), tmp_path / "counts")


@pytest.mark.parametrize("name", ["ours", "a b", "", "a/b/c", "../x"])
def test_names_of_methods_and_names_that_no_row_may_have_are_refused(clip, tmp_path, name):
    folder = write_images(clip, tmp_path / "images")
    with pytest.raises(ForeignImagesError):
        score(clip, folder, tmp_path / "r", Claim(name, 1.0))
