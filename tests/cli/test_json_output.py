"""With --json, standard output holds one document with the documented keys, and nothing else."""

from __future__ import annotations

import dataclasses
import json
import re
from typing import Any

import pytest
from typer.testing import CliRunner

from rlbench.cli import json_output
from rlbench.cli.app import app
from tests.cli.runner import CHECKOUT
from tests.conftest import write_plugin

PAGE = CHECKOUT / "docs" / "how-to" / "use-the-command-line.md"


def document(*words: object, code: int = 0) -> dict[str, Any]:
    """What a command prints to standard output, as JSON."""
    result = CliRunner().invoke(app, [*map(str, words), "--json"])
    assert result.exit_code == code, result.output
    return json.loads(result.stdout)


def keys(kind: type) -> set[str]:
    return {field.name for field in dataclasses.fields(kind)}


def test_a_run_prints_scores_counts_and_the_verdict(run_mean):
    found = document(*run_mean, "--spp", 1, "--times", "none", "--half")  # and a note, elsewhere
    assert found.keys() == keys(json_output.RunOutput)
    assert found["cells"]["measured"] == 1
    assert found["passed"]
    (row,) = found["scores"]
    assert row["method"] == "mean"
    assert row["psnr"] > 0
    assert row["frame_ms"] is None


def test_a_run_with_images_that_are_not_finite_names_them(clip_folder, tmp_path):
    plugin = write_plugin(tmp_path / "nan.py", "nan", body="return samples.mean / 0 * 0, None")
    words = ("run", "nan", "--plugin", plugin, "--clips", clip_folder, "--times", "none")
    found = document(*words, "--spp", 1, "--out", tmp_path / "r", code=1)
    assert found["nonfinite"] == [
        {"cell": "nan on noise at 1 spp, seed 0", "frame": 0, "pixels": 480, "of_pixels": 480}
    ]
    assert not found["passed"]


def test_each_check_is_listed_with_its_verdict(tmp_path):
    plugin = write_plugin(tmp_path / "bad.py", "bad", body="return samples.mean * 0 / 0, None")
    found = document("check", "bad", "--plugin", plugin, code=1)
    assert found.keys() == keys(json_output.ChecksOutput)
    (checked,) = found["checked"]
    assert checked["name"] == "bad"
    failed = [check for check in checked["checks"] if check["verdict"] == "failed"]
    assert failed
    assert all(check["remedy"] for check in failed)


@pytest.mark.app("dumps")
@pytest.mark.usefixtures("clip_folder")
def test_a_clip_is_listed_by_name_and_size(tmp_path):
    (checked,) = document("lint", tmp_path / "clips" / "noise", code=1)["checked"]
    assert checked["name"] == "noise: 24 x 20 pixels, 3 frames"


def test_report_lists_files_and_what_it_could_not_write(run_mean, tmp_path):
    document(*run_mean, "--spp", 1, "--times", "none")
    found = document("report", "summary", "--results", tmp_path / "r")
    assert found.keys() == keys(json_output.ReportOutput)
    assert f"{tmp_path}/r/report/summary.md" in found["files"]
    found = document("report", "variance", "--results", tmp_path / "r", code=2)
    assert "rlbench run --draws 4" in found["failed"]["variance"]


@pytest.mark.parametrize(
    "kind", ["RunOutput", "ReportOutput", "ChecksOutput", "CacheOutput", "ScenesOutput"]
)
def test_every_key_is_documented(kind):
    documented = set(re.findall(r"`(\w+)`", PAGE.read_text()))
    assert keys(getattr(json_output, kind)) <= documented


def test_numbers_that_are_not_finite_are_null():
    assert json.loads(json_output.as_json_text({"a": float("nan")})) == {"a": None}
