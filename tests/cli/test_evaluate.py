"""The command evaluate: from kept images to a report of other scores."""

from __future__ import annotations

import pytest

from rlbench.benchmark import results as table
from tests.cli.runner import rlbench
from tests.conftest import write_noise


@pytest.fixture
def clip_folder(image_run):
    return image_run / "clips"


def test_images_are_scored_under_conventions_and_reported(image_results, clip_folder, tmp_path):
    conventions = ("--metrics", "psnr,relmse", "--convention", "srgb,hable", "--clips", clip_folder)
    output = rlbench("evaluate", image_results, *conventions)
    assert "psnr, psnr@hable, relmse: 12 scored, 0 already in the results" in output
    assert "0 scored, 12 already" in rlbench("evaluate", image_results, *conventions)
    assert set(table.read(image_results / "evaluated")["metric"]) == {
        "psnr",
        "psnr@hable",
        "relmse",
    }
    rlbench(
        "report", "summary", "--results", image_results / "evaluated", "--out", tmp_path / "report"
    )
    assert "### psnr@hable [dB]" in (tmp_path / "report" / "summary.md").read_text()


def test_a_metric_that_fails_is_named_and_the_exit_code_is_1(
    image_results, clip_folder, monkeypatch
):
    monkeypatch.setattr("metrics.image.relmse", lambda *images: 1 / 0)
    words = ("evaluate", image_results, "--metrics", "relmse", "-m", "mean", "--clips", clip_folder)
    output = rlbench(*words, code=1)
    assert "failed: mean on noise at 1 spp, seed 0, relmse: ZeroDivisionError" in output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--metrics", "psnrr"), "error: 'psnrr' is not a metric. Did you mean 'psnr'?"),
        (("--convention", "foo"), "error: --convention foo: 'foo' is no convention"),
        (("--metrics", "relmse", "--convention", "hable"), "relmse takes no convention"),
        (("-m", "svgf"), "no images of svgf on noise; it has eaw, mean on noise"),
    ],
)
def test_wrong_use_of_evaluate_is_one_message(image_results, clip_folder, words, message):
    output = rlbench("evaluate", image_results, "--clips", clip_folder, *words, code=2)
    assert message in output
    assert "Traceback" not in output


def test_results_without_images_say_how_to_make_them(tmp_path):
    write_noise(tmp_path / "clips" / "noise")
    output = rlbench("evaluate", tmp_path, "--clips", tmp_path / "clips", code=2)
    assert "has no images; `rlbench run --keep-images` makes them" in output
