"""What a training tells over time: each frame once, however often it was killed."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.training import logger
from rlbench.training.loop import TrainingConfig, train
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

PLAN = TrainingConfig(
    frames=18, crop=16, length=3, every=6
)  # six draws, a checkpoint after each second
SCALARS = {"loss", "learning rate", "frames a second", "validation PSNR"}


class KilledError(Exception):
    """What a kill is to a test."""


def trained(folder: Path, clip: Path, *kills: int) -> Path:
    """A training that was killed after these draws, each time after going on."""
    for kill in (*kills, None):

        def report(progress: object, loss: float, kill: int | None = kill) -> None:
            if progress.draws == kill:
                raise KilledError

        try:
            train("blur", [clip], [clip], folder, PLAN, report=report)
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


def test_curves_of_a_killed_training_are_those_of_an_undisturbed_one(clip, tmp_path):
    killed, whole = trained(tmp_path / "killed", clip, 3, 5), trained(tmp_path / "whole", clip)
    assert set(board(killed).Tags()["scalars"]) == SCALARS
    for name in SCALARS - {"frames a second"}:
        assert scalars(killed, name) == scalars(whole, name)
    assert [step for step, _ in scalars(killed, "loss")] == [3, 6, 9, 12, 15, 18]
    assert [step for step, _ in scalars(killed, "validation PSNR")] == [6, 12, 18]


def test_a_picture_is_shown_beside_its_reference_at_each_validation(clip, tmp_path):
    read = board(trained(tmp_path / "run", clip))
    (name,) = read.Tags()["images"]
    assert [(e.step, e.width, e.height) for e in read.Images(name)] == [
        (seen, 2 * 24, 24) for seen in (6, 12, 18)
    ]


def test_what_was_logged_after_the_checkpoint_is_logged_once(tmp_path):
    log = tmp_path / logger.LOG
    lines = [json.dumps({"seen": seen, "psnr": 20.0}) + "\n" for seen in (6, 12, 18)]
    log.write_text("".join(lines) + '{"seen": 2')
    with logger.told(tmp_path, 12):
        assert log.read_text() == "".join(lines[:2])


def test_without_tensorboard_training_goes_on_and_one_line_says_so(clip, tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "tensorboard" else find(name)
    )
    assert 'pip install "rlbench[train]"' in logger.lacking()
    folder = trained(tmp_path / "run", clip)
    assert not (folder / logger.FOLDER).exists()
    told = [json.loads(line)["seen"] for line in (folder / logger.LOG).read_text().splitlines()]
    assert told == [6, 12, 18]
