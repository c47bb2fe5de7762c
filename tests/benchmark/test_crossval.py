"""Leaving one scene out: the weights of each fold have not seen its scene; done once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.crossval import Fold, crossval, row_names, variant_to_train
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import RunSummary
from rlbench.cli.app import app
from rlbench.training.config import TrainingConfig
from rlbench.training.dataset import TrainingSplit
from rlbench.training.runs import TrainingRuns
from rlbench.weights import read_card
from tests.conftest import write_noise
from tests.learning_plugin import write_learner


@pytest.fixture
def folds(tmp_path: Path) -> list[Fold]:
    registry.use_plugin(write_learner(tmp_path))
    city, hall = (write_noise(tmp_path / name, name, h=24, w=24) for name in ("city", "hall"))
    return [
        Fold("city", TrainingSplit([hall], [hall]), (StoredSource(city),)),
        Fold("hall", TrainingSplit([city], [city]), (StoredSource(hall),)),
    ]


def left_out(folds: list[Fold], out: Path, plan: TrainingConfig | None = None) -> RunSummary:
    plan = plan or TrainingConfig(frames=12, crop=16, sequence_length=3)
    request = RunPlan(("blur", "mean"), (), (1.0,), repeats=2)
    return crossval(folds, TrainingRuns(out, plan), request, out / "results")


def test_each_scene_is_scored_by_weights_that_have_not_seen_it(folds, tmp_path):
    assert left_out(folds, tmp_path / "out") == RunSummary(measured=4)
    rows = results.read(tmp_path / "out" / "results")
    found = {(r.method, r.scene, r.weights.rpartition(" ")[0]) for r in rows.itertuples()}
    assert found == {
        ("blur@crossval", "city", "without city"),
        ("blur@crossval", "hall", "without hall"),
        ("mean", "city", ""),
        ("mean", "hall", ""),
    }
    seen = read_card(tmp_path / "out" / "blur-without-city" / "blur.safetensors").data
    assert [clip.split()[0] for clip in seen] == ["hall"]


def test_what_is_done_is_not_done_again(folds, tmp_path):
    left_out(folds, tmp_path / "out")
    files = {file: file.stat().st_mtime_ns for file in (tmp_path / "out").rglob("*.safetensors")}
    assert left_out(folds, tmp_path / "out") == RunSummary(cached=4)
    assert files == {file: file.stat().st_mtime_ns for file in files}


@pytest.mark.parametrize(
    ("name", "teacher"), [("ours", "ours"), ("ours/flat", "ours"), ("mean", ""), ("oidn-intel", "")]
)
def test_borrowed_weights_are_trained_by_whom_they_are_borrowed_of(name, teacher):
    assert variant_to_train(name) == teacher


def test_rows_are_named_by_whether_they_were_trained_here():
    asked = RunPlan(("mean", "ntas"), ())
    assert row_names(asked) == ["mean", "ntas@crossval"]
    assert row_names(replace(asked, methods=("ntas",))) == ["ntas@crossval"]


def test_a_scene_that_cannot_be_left_out_is_told():
    words = ["crossval", "-m", "ntas", "--scenes", "attic", "--device", "cpu"]
    found = CliRunner().invoke(app, words)
    assert found.exit_code == 2
    assert "preset 'mini' has: city, temple, hall" in found.output
