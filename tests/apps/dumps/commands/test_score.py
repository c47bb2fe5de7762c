"""The commands export and score: from a clip to another program's row among those of a run."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from rlbench import metrics
from rlbench.benchmark import results as table
from tests.apps.dumps.exr_files import write_image
from tests.cli.runner import rlbench
from tests.conftest import write_noise

COSTS = ("--sample-ms", 4.2, "--frame-ms", 60_000)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Two clips, the rows of `mean`, and the exported samples as images of another program."""
    root = tmp_path_factory.mktemp("score")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(root / "cache"))
        for scene in ("city", "temple"):
            write_noise(root / "clips" / scene, scene)
        words = ("--clips", root / "clips", "--out", root / "run", "--spp", 1, "--repeats", 2)
        rlbench("run", "-m", "mean", "--keep-images", *words)
        shutil.copytree(root / "run", root / "r")
        output = rlbench("export", root / "clips", "--format", "oidn", "--out", root / "exported")
        assert "oidnDenoise --hdr" in output
    for file in (root / "exported").glob("*/[an]*.pfm"):  # albedo and normal are no images
        file.unlink()
    return root


def score(root, *words, code=0, out="r"):
    fixed = ("--spp", 1, "--clips", root / "clips", "--out", root / out)
    return rlbench("score", "theirs", root / "exported", *fixed, *words, code=code)


@pytest.fixture(scope="module")
def scored(root):
    """What was printed of images without a time, in the results folder."""
    return score(root)


def test_the_mean_of_exported_samples_is_the_row_mean_but_not_verified(scored, root):
    assert "theirs on city at 1 spp: PSNR" in scored
    assert "not verified" in scored
    assert "not ranked by time" in scored
    assert "scored before" in score(root)
    rows = table.read(root / "r").query("metric == 'psnr' and frame >= 0")
    means = rows.groupby(["method", "clip"])["value"].mean().unstack("clip")
    assert means.loc["theirs"].to_list() == pytest.approx(means.loc["mean"].to_list(), abs=1e-4)


def test_reports_have_the_row_and_say_that_it_is_not_verified(scored, root, tmp_path):
    rlbench("report", "summary", "--results", root / "r", "--out", tmp_path)
    text = (tmp_path / "summary.md").read_text()
    assert "| theirs |" in text
    assert "Not verified, images and budget as claimed: theirs." in text


def test_compare_decide_and_regress_take_the_row(scored, root):
    words = ("--results", root / "r")
    output = rlbench("compare", "-m", "theirs,mean", *words)
    assert "tie" in output
    assert "not verified" in output
    assert "theirs has no time" in rlbench("decide", *COSTS, *words)
    baseline = ("--baseline", root / "base.json")
    rlbench("regress", *words, *baseline, "--update")
    assert "passed: 4 same" in rlbench("regress", *words, *baseline)


def test_view_and_images_show_the_kept_images(scored, root, tmp_path):
    rlbench("view", root / "r", "--clips", root / "clips", "--out", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "theirs" in page
    assert "not verified" in page
    output = rlbench("evaluate", root / "r", "-m", "theirs", "--clips", root / "clips")
    assert "2 scored" in output


@pytest.mark.parametrize("device", ["", "RTX 4090"])
def test_a_claimed_time_is_ranked_among_measured_ones_and_marked(root, device):
    out = f"timed {device}"
    shutil.copytree(root / "run", root / out)
    score(root, "--ms", 2.5, *(("--device", device) if device else ()), out=out)
    words = ("decide", *COSTS, "--results", root / out)
    output = rlbench(*words)
    assert "theirs at 1 spp" in output
    assert "mean at 1 spp" in output
    assert "6.7*" in output
    assert "not verified: the time is claimed" in output
    assert "rlbench run -m theirs" not in output
    assert "theirs" in rlbench("compare", "mean", "theirs", "--results", root / out)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--scenes", "cty"), "Did you mean 'city'?"),
        (("--device", "RTX 4090"), "add --ms"),
        (("--samples", "absent"), "absent does not exist"),
        (("--spp", 99), "--spp 99: clip 'city' stores"),
        (("--metrics", "ssim"), "--metrics is for two image files"),
    ],
)
def test_wrong_use_of_score_is_one_message(root, words, message):
    assert message in score(root, *words, code=2)


# Two files


@pytest.fixture
def files(tmp_path, monkeypatch) -> tuple[str, str]:
    """An image and its reference in the current folder."""
    monkeypatch.chdir(tmp_path)
    noise = np.random.default_rng(7).normal(0, 0.05, (180, 200, 3))
    reference = np.indices((180, 200, 3))[0] / 200
    write_image(tmp_path / "i.exr", (reference + noise).clip(0, 1).astype(np.float32))
    write_image(tmp_path / "r.exr", reference.astype(np.float32))
    return "i.exr", "r.exr"


def test_two_files_are_scored(files):
    output = rlbench("score", *files)
    assert f"{metrics.psnr(*files):.5g}" in output
    assert "clipped sRGB" in output
    words = ("--metrics", "psnr,smape", "--convention", "hable", "--exposure", 0.5, "--json")
    document = json.loads(rlbench("score", *files, *words))
    options = {"data_range": 2.0, "convention": "hable"}
    expected = metrics.score(*files, ["psnr", "smape"], **options)
    assert {row["metric"]: row["value"] for row in document["scores"]} == pytest.approx(expected)
    assert document["scores"][0]["better"] == "higher"


def test_remarks_about_two_files(files, tmp_path):
    hole = np.zeros((180, 200, 3), np.float32)
    hole[3] = np.nan
    write_image(tmp_path / "hole.exr", hole)
    Image.fromarray(np.zeros((180, 200, 3), np.uint8)).save(tmp_path / "i.png")
    for file, remark in (("hole.exr", "200 pixels are NaN"), ("i.png", "files of two kinds")):
        document = json.loads(rlbench("score", file, "r.exr", "--json"))
        assert remark in document["remarks"][0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("i.exr", "absent.exr"), "there is no file .*absent.exr"),
        (("i.exr", "i.exr", "--spp", 1), "--spp is for folders of images. Omit it"),
        (("nrd", "."), "--spp is needed for a folder of images.*rlbench score IMAGE REFERENCE"),
    ],
)
def test_wrong_use_of_two_files_is_one_message(files, words, message):
    output = rlbench("score", *words, code=2)
    assert re.search(message, output), output
