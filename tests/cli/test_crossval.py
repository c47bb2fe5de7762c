"""Cross-validation: the weights of a fold were trained without its scene, and only once."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.benchmark import results
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import ProgressCallbacks, RunSummary
from rlbench.cli.crossval_folds import Fold, crossval, row_names, variant_to_train
from rlbench.training.dataset import TrainingSplit
from rlbench.training.loop import TrainingRuns
from rlbench.training.task import TrainingConfig
from rlbench.weights import read_card
from tests.conftest import write_noise
from tests.learning_plugin import write_learner


@pytest.fixture
def folds(tmp_path: Path) -> list[Fold]:
    registry.use_plugin(write_learner(tmp_path))
    city, hall = (write_noise(tmp_path / name, name, h=24, w=24) for name in ("city", "hall"))
    return [
        Fold("city", TrainingSplit([hall], {"hall": [hall]}), (StoredSource(city),)),
        Fold("hall", TrainingSplit([city], {"city": [city]}), (StoredSource(hall),)),
    ]


def run_crossval(folds: list[Fold], out: Path, **callbacks: object) -> RunSummary:
    config = TrainingConfig(frames=12, crop=16, sequence_length=3)
    plan = RunPlan(("blur", "mean"), (), (1.0,), repeats=2)
    return crossval(folds, TrainingRuns(out, config), plan, out / "results", **callbacks)


def test_each_scene_is_scored_with_weights_that_were_trained_without_it(folds, tmp_path):
    messages, measured = [], []

    @contextmanager
    def progress_bar(plan):
        yield ProgressCallbacks(on_cell=lambda cell: measured.append((plan.methods, cell.key.clip)))

    callbacks = {"on_fold": messages.append, "progress_bar": progress_bar}
    assert run_crossval(folds, tmp_path / "out", **callbacks) == RunSummary(measured=4)
    assert messages == [
        f"fold {index} of 2: {method} without {scene}"
        for index, scene in ((1, "city"), (2, "hall"))
        for method in ("blur", "mean")
    ]
    assert measured == [((m,), scene) for scene in ("city", "hall") for m in ("blur", "mean")]
    rows = results.read(tmp_path / "out" / "results")
    weights = {(r.method, r.scene, r.weights_hash.rpartition(" ")[0]) for r in rows.itertuples()}
    assert weights == {
        ("blur@crossval", "city", "without city"),
        ("blur@crossval", "hall", "without hall"),
        ("mean", "city", ""),
        ("mean", "hall", ""),
    }
    for scene, other in (("city", "hall"), ("hall", "city")):
        card = read_card(tmp_path / "out" / f"blur-without-{scene}" / "blur.safetensors")
        assert [clip.split()[0] for clip in card.data] == [other]


@pytest.mark.parametrize(
    ("name", "trained"),
    [
        ("ours", "ours"),
        ("ours/flat", "ours"),
        ("oidn/tuned", "oidn/tuned"),
        ("mean", ""),
        ("oidn", ""),
        ("oidn-intel", ""),
    ],
)
def test_weights_of_another_variant_are_trained_as_that_variant(name, trained):
    assert variant_to_train(name) == trained


def test_only_trained_methods_have_the_label_crossval():
    plan = RunPlan(("mean", "oidn", "ntas"), ())
    assert row_names(plan) == ["mean", "oidn", "ntas@crossval"]
    assert row_names(replace(plan, methods=("ntas",))) == ["ntas@crossval"]
