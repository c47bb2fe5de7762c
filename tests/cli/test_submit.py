"""The commands submit and verify, on a small clip."""

from __future__ import annotations

import json

import pytest

from tests.cli.runner import rlbench
from tests.conftest import write_plugin


@pytest.fixture
def run(run_mean, clip_folder, tmp_path):
    """Results of `mean` on one clip, and the words that name its folder."""
    rlbench(*run_mean, "--spp", "1,2", "--scores-only")
    return tmp_path / "r", ("--clips", clip_folder)


def edit(file, change):
    """The file with another document."""
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


def test_a_submission_is_verified_and_measured_again(run):
    results, clips = run
    output = rlbench("submit", results, *clips, "--contact", "nobody@example.org")
    file = results / "submission.rlbench.json"
    assert f"{file}: 2 cells, content hash" in output
    assert json.loads(file.read_text())["contact"] == "nobody@example.org"
    output = rlbench("verify", file, *clips, "--rerun", 2, "--against", results)
    assert "✓ measured again: mean on noise at 1 spp, seed 0" in output
    assert "✓ scores against" in output
    assert "warning: 0, failed: 0" in output


def test_a_changed_number_fails(run):
    results, clips = run
    rlbench("submit", results, *clips)
    file = results / "submission.rlbench.json"
    edit(file, lambda document: document["cells"][0]["scores"]["psnr"].__setitem__(0, 30.0))
    output = rlbench("verify", file, *clips, code=1)
    assert "✗ content hash" in output


def test_results_of_other_code_are_refused_before_the_file_is_written(
    run_mean, clip_folder, tmp_path
):
    plugin = write_plugin(tmp_path / "odd.py", "odd")
    words = ("--plugin", plugin, "--clips", clip_folder)
    results = tmp_path / "r"
    rlbench("run", "-m", "odd", *words, "--spp", 1, "--scores-only", "--out", results)
    write_plugin(plugin, "odd", gain=2.0)
    output = rlbench("submit", results, *words, code=2)
    assert "1 cells, such as odd on noise at 1 spp, seed 0, were measured with other code" in output
    assert not (results / "submission.rlbench.json").exists()


def test_rows_that_others_cannot_measure_are_named(run):
    results, clips = run
    table = rlbench("submit", results, *clips)
    assert "cannot measure these rows again" not in table
    file = results / "submission.rlbench.json"
    edit(file, lambda document: [c.__setitem__("method", "mean@mine") for c in document["cells"]])
    output = rlbench("verify", file, *clips, "--rerun", 1, code=1)
    assert "no row can be measured here" in output


def test_verify_says_what_a_file_is_not(tmp_path):
    (tmp_path / "x.json").write_text("{}")
    output = rlbench("verify", tmp_path / "x.json", code=2)
    assert (
        "has schema None, this version reads 1. A submission is written by rlbench submit" in output
    )


def test_submit_without_its_clips_says_how_to_name_them(run):
    output = rlbench("submit", run[0], code=2)
    assert "the clips noise are not here" in output
    assert "--clips" in output
