"""Commands of dumps, and render: what they hand over, and what they refuse."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from rlbench import backends, metrics
from rlbench.apps.dumps.commands.denoise import _choose_backend
from rlbench.apps.render.jobs import render_clips
from rlbench.benchmark import results as table
from rlbench.clips.stored import open_clip
from rlbench.denoise import DEFAULT_METHOD
from rlbench.training import dataset
from tests.apps.dumps.exr_files import read_planes, write_image
from tests.apps.dumps.importers.dumps import write_blender
from tests.apps.dumps.lint.broken_fixtures import correct_clip
from tests.cli.runner import rlbench
from tests.conftest import write_noise


@pytest.fixture
def ensured(monkeypatch):
    """The presets, scenes and seeds whose clips would be rendered."""
    calls = []
    monkeypatch.setattr(
        render_clips, "ensure", lambda *requested: calls.append(requested[:3]) or []
    )
    return calls


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--scenes", "cellar"), "error: no scene 'cellar'; available: bathroom, bathroom2, city"),
        (("--scenes", "city-crane"), "has no take 'crane'; available takes: static, cut"),
        (("--seeds", "48:0"), "Invalid value for '--seeds': '48:0' is not a list of seeds"),
        (("--buffers", "taste"), "error: "),
        (("--engine", "local=auto"), "error: --engine local=auto: local has no address"),
    ],
)
def test_wrong_use_of_render_is_one_message(words, message):
    assert message in rlbench("render", *words, code=2)


def test_render_and_training_request_the_clips_of_the_seeds(ensured):
    rlbench("render", "--preset", "train", "--seeds", "0:48")
    dataset.split_generated("train", (30, 31))
    dataset.split_generated("mini", (30, 31))  # generated scenes, as large as those of mini
    assert [(preset.name, scenes, seeds) for preset, scenes, seeds in ensured] == [
        ("train", None, tuple(range(48))),
        ("train", None, (30, 31)),
        ("mini", None, (30, 31)),
    ]


def test_options_of_render_change_the_preset(ensured):
    rlbench("render", "--radiance-cap", 64, "--buffers", "object,normal_psr", "--takes", "all")
    ((preset, _, _),) = ensured
    assert preset.radiance_cap == 64
    assert {"object", "normal_psr"} <= set(preset.extra_buffers)
    assert preset.takes == "all"


@pytest.mark.parametrize(("requested", "takes"), [(None, "all"), ("main", "main")])
def test_the_takes_of_a_preset_can_be_chosen(ensured, requested, takes):
    render_clips.render_preset_clips(None, "standard", takes=requested)
    assert [(preset.name, preset.takes) for preset, _, _ in ensured] == [("standard", takes)]


def test_render_can_print_hashes_and_measure_the_time_of_a_sample(clip_folder, monkeypatch):
    monkeypatch.setattr(render_clips, "ensure", lambda *_, **__: [Path(clip_folder)])
    clip = open_clip(clip_folder)
    assert rlbench("render", "--digests").strip() == f"{clip.name} {clip.digest[:12]}"
    output = rlbench("render", "--remeasure-sample-time", code=2)
    assert "was rendered on 'another machine'" in output  # by the function that measures


def test_lint_of_a_folder_without_clips_is_wrong_use(tmp_path):
    assert "error: no clip in" in rlbench("lint", tmp_path, code=2)
    assert "Invalid value for 'CLIPS" in rlbench("lint", tmp_path / "nowhere", code=2)


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


def test_openvino_denoises_as_pytorch_does_and_frames_say_who_did(render, tmp_path):
    words = ("denoise", render, "-m", "oidn", "--spp", 1)
    rlbench(*words, "-o", tmp_path / "eager")
    output = rlbench(*words, "-o", tmp_path / "compiled", "--backend", "openvino")
    assert "2 frames denoised by oidn on openvino" in output
    files = [sorted((tmp_path / name).glob("*.exr")) for name in ("eager", "compiled")]
    for expected, found in zip(*files, strict=True):
        for name, plane in read_planes(expected).items():  # halves in the files
            np.testing.assert_allclose(read_planes(found)[name], plane, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize(("device", "expected"), [("cpu", "eager"), ("cuda", "graph")])
def test_denoise_replays_graphs_on_a_gpu_alone_by_default(monkeypatch, device, expected):
    monkeypatch.setattr(backends, "can_record", lambda recorder, device: True)
    assert _choose_backend("svgf", None, torch.device(device)) == expected
    assert _choose_backend("svgf", "eager", torch.device(device)) == "eager"


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


# Export and score: from a clip to another program's row among those of a run


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
    for file in (root / "exported").glob("*/[an]*.pfm"):  # albedo and normal are not images
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
