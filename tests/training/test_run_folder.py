"""The folder of a run: its log, the state that is read from it, and the weights that it holds."""

from __future__ import annotations

import importlib.util
import json
from contextlib import suppress
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.errors import OptionError
from rlbench.training import TrainingConfig, run_folder, train
from rlbench.training.run_folder import RunState, find_weights, read_state
from tests.conftest import write_noise
from tests.learning_plugin import write_learner
from tests.training.test_loop import KilledError, kill_after

STATUS = {"frames": 400, "frames_seen": 250, "seconds": 65.0, "finished": False}


def test_a_run_that_has_not_begun_has_no_state(tmp_path):
    assert read_state(tmp_path) == RunState()
    assert read_state(tmp_path).seconds_left is None


def test_the_speed_is_that_of_the_last_validations(tmp_path):
    status = STATUS | {"validation": {"a": {"psnr": 20.5, "first_frames": 19.0}}}
    (tmp_path / "status.json").write_text(json.dumps(status))
    assert read_state(tmp_path).speed == pytest.approx(250 / 65)
    lines = [(100, 1.0), (200, 60.0), (250, 65.0)]
    log = "".join(f'{{"frames_seen": {f}, "seconds": {s}}}\n' for f, s in lines)
    (tmp_path / "log.jsonl").write_text(log + '{"frames_see')
    state = read_state(tmp_path)
    assert state.speed == pytest.approx(150 / 64)
    assert state.seconds_left == pytest.approx(64)
    assert state.validation == {"a": 20.5}


def test_weights_are_found_by_file_and_by_run(tmp_path):
    folder = tmp_path / "ours-A2"
    folder.mkdir()
    weights = folder / "A2.safetensors"
    for file in (weights, weights.with_suffix(".toml"), folder / "checkpoint.safetensors"):
        file.touch()
    assert find_weights("ours/A2", tmp_path) == find_weights(str(weights), tmp_path) == weights
    assert find_weights(None, tmp_path) is None
    assert find_weights("ours/A1", tmp_path) == registry.shipped_weights("ours/A1")
    own = find_weights("ours/A2", tmp_path, ["ours/A2"])  # a run that resumes has its first start
    assert own == registry.shipped_weights("ours/A2")


@pytest.mark.parametrize("start", ["ours/A2", "dasr/intel", "unknown"])
def test_weights_that_are_not_there_are_an_error(tmp_path, start):
    (tmp_path / "ours-A2").mkdir()  # a run that is not finished hides the shipped weights
    with pytest.raises(OptionError, match=f"--start {start}: there is no such weights file"):
        find_weights(start, tmp_path)


# six sequences, a checkpoint after every second one
CONFIG = TrainingConfig(frames=18, crop=16, sequence_length=3, eval_interval=6)
SCALARS = {
    "loss",
    "learning rate",
    "frames a second",
    "validation PSNR",
    "validation PSNR/validation",
    "validation PSNR of first frames/validation",
    "validation drift/validation",
}


def train_killed(folder: Path, clip: Path, *kills: int) -> Path:
    """A run that was killed after these sequences, and resumed each time."""
    for kill in (*kills, None):
        with suppress(KilledError):
            train("blur", [clip], [clip], folder, CONFIG, on_progress=kill_after(kill))
    return folder


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    registry.use_plugin(write_learner(tmp_path))
    return write_noise(tmp_path / "clips" / "noise", h=24, w=24)


def board(folder: Path) -> object:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    read = accumulator.EventAccumulator(str(folder / run_folder.TENSORBOARD))
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
    log = tmp_path / run_folder.LOG
    lines = [json.dumps({"frames_seen": frames, "psnr": 20.0}) + "\n" for frames in (6, 12, 18)]
    log.write_text("".join(lines) + '{"frames_seen": 2')
    run_folder.TrainingLogger(tmp_path, 12).close()
    assert log.read_text() == "".join(lines[:2])


def test_training_works_without_tensorboard_and_one_line_says_so(clip, tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "tensorboard" else find(name)
    )
    assert 'pip install "rlbench[train]"' in run_folder.tensorboard_hint()
    folder = train_killed(tmp_path / "run", clip)
    assert not (folder / run_folder.TENSORBOARD).exists()
    lines = (folder / run_folder.LOG).read_text().splitlines()
    assert [json.loads(line)["frames_seen"] for line in lines] == [6, 12, 18]
