"""The training log: each frame is logged once, however often the run was killed."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.training import TrainingConfig, logger, train
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

# six sequences, a checkpoint after every second one
CONFIG = TrainingConfig(frames=18, crop=16, sequence_length=3, eval_interval=6)
SCALARS = {
    "loss",
    "learning rate",
    "frames a second",
    "validation PSNR",
    "validation PSNR/validation",
    "validation PSNR of first frames/validation",
}


class KilledError(Exception):
    """Stands for a kill."""


def train_killed(folder: Path, clip: Path, *kills: int) -> Path:
    """A run that was killed after these sequences, and resumed each time."""
    for kill in (*kills, None):

        def on_progress(progress: object, loss: float, kill: int | None = kill) -> None:
            if progress.sequences == kill:
                raise KilledError

        try:
            train("blur", [clip], [clip], folder, CONFIG, on_progress=on_progress)
        except KilledError:
            continue
    return folder


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    registry.use_plugin(write_learner(tmp_path))
    return write_noise(tmp_path / "clips" / "noise", h=24, w=24)


def board(folder: Path) -> object:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    read = accumulator.EventAccumulator(str(folder / logger.FOLDER))
    read.Reload()
    return read


def scalars(folder: Path, name: str) -> list[tuple[int, float]]:
    return [(event.step, event.value) for event in board(folder).Scalars(name)]


def test_the_log_of_a_killed_run_is_that_of_an_undisturbed_one(clip, tmp_path):
    killed = train_killed(tmp_path / "killed", clip, 3, 5)
    undisturbed = train_killed(tmp_path / "undisturbed", clip)
    assert set(board(killed).Tags()["scalars"]) == SCALARS
    for name in SCALARS - {"frames a second"}:
        assert scalars(killed, name) == scalars(undisturbed, name)
    assert [step for step, _ in scalars(killed, "loss")] == [3, 6, 9, 12, 15, 18]
    assert [step for step, _ in scalars(killed, "validation PSNR")] == [6, 12, 18]


def test_each_validation_logs_an_image_beside_its_reference(clip, tmp_path):
    read = board(train_killed(tmp_path / "run", clip))
    (name,) = read.Tags()["images"]
    assert [(e.step, e.width, e.height) for e in read.Images(name)] == [
        (frames, 2 * 24, 24) for frames in (6, 12, 18)
    ]


def test_entries_after_the_checkpoint_are_dropped(tmp_path):
    log = tmp_path / logger.LOG
    lines = [json.dumps({"frames_seen": frames, "psnr": 20.0}) + "\n" for frames in (6, 12, 18)]
    log.write_text("".join(lines) + '{"frames_seen": 2')
    logger.TrainingLogger(tmp_path, 12).close()
    assert log.read_text() == "".join(lines[:2])


def test_training_works_without_tensorboard_and_one_line_says_so(clip, tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "tensorboard" else find(name)
    )
    assert 'pip install "rlbench[train]"' in logger.tensorboard_hint()
    folder = train_killed(tmp_path / "run", clip)
    assert not (folder / logger.FOLDER).exists()
    lines = (folder / logger.LOG).read_text().splitlines()
    assert [json.loads(line)["frames_seen"] for line in lines] == [6, 12, 18]
