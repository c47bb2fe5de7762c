"""The command video, on a small clip."""

from __future__ import annotations

import pytest
from PIL import Image

from tests.cli.runner import rlbench


@pytest.fixture
def run(clip_folder, tmp_path):
    """Runs mean and eaw at 1 and 2 spp on the small clip; returns the results."""

    def run_with(*words):
        out = tmp_path / "r"
        shared = ("--clips", clip_folder, "--scores-only", "--out", out)
        rlbench("run", "-m", "mean,eaw", "--spp", "1,2", *shared, *words)
        return out

    return run_with


def size(file):
    with Image.open(file) as image:
        return image.size


def test_video_writes_one_file_for_each_budget_and_prints_its_name(run, clip_folder):
    results = run("--keep-images")
    words = ("-m", "eaw,mean", "--clips", clip_folder, "--spp", "1,2", "--no-labels", "--zoom", 3)
    output = rlbench("video", results, *words)
    for spp in (1, 2):
        file = results / "video" / f"noise-{spp}spp-eaw-mean.webp"
        assert str(file) in output
        assert size(file) == (2 * 3 * 24 + 4, 3 * 20)


def test_video_without_names_shows_all_rows_with_the_best_last(run, clip_folder, tmp_path):
    out = tmp_path / "videos"
    results = run("--keep-images")
    rlbench("video", results, "--clips", clip_folder, "--reference", "--out", out)
    assert [file.name for file in out.iterdir()] == ["noise-1spp-mean-eaw-reference.webp"]


def test_video_of_a_run_without_images_names_the_cells_and_the_command(run):
    output = rlbench("video", run(), "-m", "mean", "--spp", "1,2", code=2)
    assert "no images of mean on noise at 1 spp; mean on noise at 2 spp" in output
    command = "rlbench run -m mean --clips FOLDER --scenes noise --spp 1,2 --keep-images --out"
    assert command in output


def test_the_command_that_is_named_makes_the_images(run, clip_folder, tmp_path):
    results = run()
    output = rlbench("video", results, "-m", "eaw", code=2)
    command = output.partition(": rlbench ")[2].split()
    words = [str(clip_folder) if word == "FOLDER" else word for word in command]
    rlbench(*words)
    assert "noise-1spp-eaw.webp" in rlbench("video", results, "-m", "eaw", "--clips", clip_folder)


def test_video_of_a_missing_budget_or_row_says_what_there_is(run, clip_folder):
    results = run("--keep-images")
    assert "no images of mean on noise at 8 spp" in rlbench(
        "video", results, "-m", "mean", "--spp", 8, code=2
    )
    assert "no rows of svgf; available: eaw, mean" in rlbench(
        "video", results, "-m", "svgf", code=2
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--crop", "0,0,64"), "no part of a frame. Give X,Y,WIDTH,HEIGHT"),
        (("--crop", "0,0,64,64"), "no part of frames of 24 x 20 pixels"),
        (("--layout", "wipe", "-m", "mean"), "a wipe shows two images"),
        (("--format", "gif"), "no such format; use mp4, webp"),
    ],
)
def test_wrong_options_are_errors_before_anything_is_written(run, words, message):
    results = run("--keep-images")
    assert message in rlbench("video", results, *words, code=2)
    assert not (results / "video").exists()
