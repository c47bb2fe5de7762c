"""rlbench train --queue: the options of its file, and what it shows."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.training import queue
from rlbench.training.queue import Queue
from tests.cli.runner import rlbench


@pytest.fixture
def trainings(monkeypatch) -> list[queue.Training]:
    """The trainings that would run."""
    prepared: list[queue.Training] = []

    def record(self: Queue, minutes: float) -> list[queue.RowStatus]:
        prepared.extend(self.trainings)
        prepared.append(self.at_once)
        return []

    monkeypatch.setattr(Queue, "run", record)
    return prepared


def write(tmp_path: Path, *lines: str) -> Path:
    (tmp_path / "q.toml").write_text("\n".join(lines))
    return tmp_path / "q.toml"


ROW = ("[[training]]", "method = 'oidn/retrained'")


def test_each_entry_becomes_a_command_line_and_a_folder(trainings, tmp_path):
    keys = ("frames = 60", "train_spp = [1, 4]", "bf16 = true", "clips = ['a', 'b']")
    later = ("[[training]]", "name = 'later'", "method = 'ours/A2'", "start = 'oidn/retrained'")
    file = write(tmp_path, "[queue]", "at_once = 3", *ROW, *keys, *later)
    rlbench("train", "--queue", file, "--out", "r", "--crop", 32)
    first, second, at_once = trainings
    words = "--methods oidn/retrained --out r --frames 60 --clips a --clips b --crop 32"
    assert " ".join(first.words) == f"{words} --train-spp 1,4 --bf16"
    assert (first.folder, first.frames) == (Path("r/oidn-retrained-1+4spp"), 60)
    start = "--crop 32 --start r/oidn-retrained-1+4spp/retrained.safetensors"
    assert " ".join(second.words) == f"--methods ours/A2 --out r/later {start}"
    assert (second.folder, second.frames) == (Path("r/later/ours-A2"), 12_000)
    assert at_once == 3


@pytest.mark.parametrize(("lines", "at_once"), [([], 1), (["[queue]", "at_once = 3"], 3)])
def test_one_training_at_a_time_runs_on_a_gpu_unless_the_file_says_more(
    trainings, tmp_path, lines, at_once
):
    file = write(tmp_path, *lines, *ROW)
    rlbench("train", "--queue", file, "--device", "cuda", "--batch", 16)
    assert trainings[0].words[-4:] == ("--device", "cuda", "--batch", "16")
    assert trainings[1] == at_once


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("eval_intervall = 3", "no option 'eval_intervall'. Did you mean 'eval_interval'?"),
        ("out = 'runs'", "no option 'out'"),
        ("bf16 = 1", "bf16 = 1 is not true or false"),
        ("frames = true", "frames = True is not a value"),
        (
            "frames = 'many'",
            "'oidn/retrained': Invalid value for '--frames': Input should be a valid integer",
        ),
        ("train_spp = 'lots'", "Invalid value for '--train-spp': 'lots' is no list of budgets"),
        ("[[training]]\nmethod = 'nttas'", "Did you mean 'ntas'?"),
        ("[[training]]\nmethod = 'mean'", "nothing to train: mean has"),
        ("[[training]]\nmethod = 'oidn/*'", "'oidn/*' is a pattern"),
    ],
)
def test_a_mistake_is_an_error_before_anything_starts(trainings, tmp_path, line, message):
    file = write(tmp_path, *ROW, line)
    assert message in rlbench("train", "--queue", file, "--out", tmp_path / "r", code=2)
    assert not trainings


@pytest.mark.parametrize("option", ["--status", "--pause", "--unpause"])
def test_options_of_a_queue_need_one(option):
    assert f"error: {option} is of a queue" in rlbench("train", "-m", "ours", option, code=2)


@pytest.mark.parametrize("words", [("-m", "ours"), ("--restart",)])
def test_options_of_one_training_are_refused_with_a_queue(tmp_path, words):
    file = write(tmp_path, *ROW)
    assert "has no effect with --queue" in rlbench("train", "--queue", file, *words, code=2)


def test_a_failed_training_gives_exit_code_1_and_its_error(tmp_path, monkeypatch):
    monkeypatch.setattr(queue, "_use_spare_time", lambda: None)  # it may wait for long
    file = write(tmp_path, *ROW, "holdout = 'attic'")
    output = rlbench("train", "--queue", file, "--out", tmp_path / "r", code=1)
    assert "oidn/retrained failed 0 of 12000" in output
    assert "exit code 2: error: " in output
    assert output.endswith("1 failed")
