"""rlbench denoise: what it says, and what it refuses."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from rlbench.denoise import DEFAULT_METHOD
from tests.apps.dumps.exr_files import read_planes
from tests.apps.dumps.importers.dumps import write_blender
from tests.apps.dumps.lint.broken_fixtures import correct_clip
from tests.cli.runner import rlbench


@pytest.fixture(scope="module")
def render(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dump")
    write_blender(correct_clip(frames=2, half=16), folder)
    return shutil.copytree(folder / "sample0", folder / "render")


def test_a_shot_is_denoised_once(render, tmp_path):
    words = ("denoise", render, "--spp", 64, "--out", tmp_path)
    first = rlbench(*words, "-m", "accumulate/tuned")
    assert "2 frames denoised" in first
    assert "same number in every pixel" in first
    assert "accumulate/intel" in first  # more samples than it was trained on
    assert "0 frames denoised by accumulate/tuned, 2" in rlbench(*words, "-m", "accumulate/tuned")
    assert len(list(tmp_path.glob("*.exr"))) == 2


def test_the_default_row_was_trained_at_any_number_of_samples(render, tmp_path):
    output = rlbench("denoise", render, "--spp", 64, "--out", tmp_path)
    assert f"2 frames denoised by {DEFAULT_METHOD}" in output
    assert "trained up to" not in output


def test_one_image_by_a_row_without_memory(render, tmp_path):
    image = sorted(render.iterdir())[0]
    output = rlbench("denoise", image, "-m", "oidn", "--spp", 1, "-o", tmp_path)
    assert "1 frame denoised by oidn" in output
    assert "note" not in output


def test_openvino_denoises_as_pytorch_does_and_frames_say_who_did(render, tmp_path):
    words = ("denoise", render, "-m", "oidn", "--spp", 1)
    rlbench(*words, "-o", tmp_path / "eager")
    output = rlbench(*words, "-o", tmp_path / "compiled", "--backend", "openvino")
    assert "2 frames denoised by oidn on openvino" in output
    files = [sorted((tmp_path / name).glob("*.exr")) for name in ("eager", "compiled")]
    for expected, found in zip(*files, strict=True):
        for name, plane in read_planes(expected).items():  # halves in the files
            np.testing.assert_allclose(read_planes(found)[name], plane, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("words", "noun"),
    [
        (("-m", "restir"), "accumulate"),
        (("-m", "oidm"), "oidn"),
        (("--albedo", "none.exr"), "none.exr"),
        (("--layout", "falcor"), "falcor"),
        (("--spp", "0.5"), "spp"),
        (("--frames", "7"), "FIRST:END"),
    ],
)
def test_what_cannot_be_done_is_said(render, tmp_path, words, noun):
    assert noun in rlbench("denoise", render, *words, "-o", tmp_path, code=2)
