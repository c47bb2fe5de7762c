"""The command video, on a small clip."""

from __future__ import annotations

import pytest
from PIL import Image

from tests.cli.runner import rlbench


def size(file):
    with Image.open(file) as image:
        return image.size


def test_video_writes_one_file_for_each_budget_and_prints_its_name(image_results, image_run):
    words = ("--clips", image_run / "clips", "--spp", "1,2", "--no-labels", "--zoom", 3)
    output = rlbench("video", image_results, "-m", "eaw,mean", *words)
    for spp in (1, 2):
        file = image_results / "video" / f"noise-{spp}spp-eaw-mean.webp"
        assert str(file) in output
        assert size(file) == (2 * 3 * 24 + 4, 3 * 20)


def test_video_without_names_shows_all_rows_with_the_best_last(image_results, image_run, tmp_path):
    out = tmp_path / "videos"
    rlbench("video", image_results, "--clips", image_run / "clips", "--reference", "--out", out)
    assert [file.name for file in out.iterdir()] == ["noise-1spp-mean-eaw-reference.webp"]


def test_video_of_a_run_without_images_names_the_cells_and_the_command(plain_results):
    output = rlbench("video", plain_results, "-m", "mean", "--spp", "1,2", code=2)
    assert "no images of mean on noise at 1 spp; mean on noise at 2 spp" in output
    command = "rlbench run -m mean --clips FOLDER --scenes noise --spp 1,2 --keep-images --out"
    assert command in output


def test_the_command_that_is_named_makes_the_images(plain_results, image_run):
    output = rlbench("video", plain_results, "-m", "eaw", code=2)
    command = output.partition(": rlbench ")[2].split()
    clips = str(image_run / "clips")
    rlbench(*[clips if word == "FOLDER" else word for word in command])
    assert "noise-1spp-eaw.webp" in rlbench("video", plain_results, "-m", "eaw", "--clips", clips)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-m", "mean", "--spp", 8), "no images of mean on noise at 8 spp"),
        (("-m", "svgf"), "no rows of svgf; available: eaw, mean"),
        (("--crop", "0,0,64"), "no part of a frame. Give X,Y,WIDTH,HEIGHT"),
        (("--crop", "0,0,64,64"), "no part of frames of 24 x 20 pixels"),
        (("--layout", "wipe", "-m", "mean"), "a wipe shows two images"),
        (("--format", "gif"), "no such format; use mp4, webp"),
    ],
)
def test_wrong_options_are_errors_before_anything_is_written(image_results, words, message):
    assert message in rlbench("video", image_results, *words, code=2)
    assert not (image_results / "video").exists()
