"""Runs of several methods: their folders, and runs that are archived."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.training import TrainingConfig, TrainingError
from rlbench.training.dataset import TrainingSplit
from rlbench.training.runs import TrainingRuns, archive_run
from tests.conftest import write_noise
from tests.learning_plugin import write_learner


@pytest.mark.parametrize(
    ("spp", "arguments", "name"),
    [
        ((), ("ours/A2",), "ours-A2"),
        ((), ("ours", "hall"), "ours-without-hall"),
        ((0.5, 4.0), ("ours",), "ours-0.5+4spp"),
        ((0.5, 4.0), ("ours", "hall"), "ours-without-hall-0.5+4spp"),
    ],
)
def test_each_variant_fold_and_choice_of_budgets_has_its_own_folder(tmp_path, spp, arguments, name):
    runs = TrainingRuns(tmp_path, TrainingConfig(spp=spp))
    assert runs.folder(*arguments) == tmp_path / name


def test_an_archived_run_does_not_replace_older_ones(tmp_path):
    folder = tmp_path / "ours"
    assert archive_run(folder) is None
    for number in (1, 2):
        folder.mkdir()
        (folder / "log").write_text(str(number))
        assert archive_run(folder) == tmp_path / f"ours.old-{number}"
    assert [(tmp_path / f"ours.old-{n}" / "log").read_text() for n in (1, 2)] == ["1", "2"]


def test_a_budget_that_one_of_the_methods_does_not_support_is_refused(tmp_path):
    runs = TrainingRuns(tmp_path, TrainingConfig(spp=(0.5,)))
    with pytest.raises(TrainingError, match="'ntas' cannot be trained at 0.5 spp"):
        runs.check(["ours", "ntas"])


class RecordingBar:
    """A progress bar that records its calls."""

    def __init__(self) -> None:
        self.opened: list[tuple[str, int]] = []
        self.frames: list[int] = []

    @contextmanager
    def __call__(self, title: str, frames: int):
        self.opened.append((title, frames))
        yield lambda progress, loss: self.frames.append(progress.frames_seen)


@pytest.fixture
def split(tmp_path: Path) -> TrainingSplit:
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "clips" / "noise", h=24, w=24)
    return TrainingSplit([clip], {"noise": [clip]})


def test_training_shows_its_progress_in_the_given_bar(tmp_path, split):
    bar = RecordingBar()
    config = TrainingConfig(frames=6, crop=16, sequence_length=3)
    weights = TrainingRuns(tmp_path / "runs", config, progress_bar=bar).train("blur", split)
    assert weights == tmp_path / "runs" / "blur" / "blur.safetensors"
    assert weights.exists()
    assert (bar.opened, bar.frames) == ([("blur", 6)], [3, 6])
