"""rlbench train --queue: the options of its file, and what it shows."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench.training import queue
from tests.cli.runner import rlbench


@pytest.fixture
def ran(monkeypatch) -> list[queue.Training | int]:
    """The trainings that would run, and how many at once."""
    arguments: list[queue.Training | int] = []

    def record(trainings: list[queue.Training], out: Path, at_once: int, *_: object) -> None:
        arguments.extend([*trainings, at_once])

    monkeypatch.setattr(queue, "run_queue", record)
    return arguments


def write(tmp_path: Path, *lines: str) -> Path:
    (tmp_path / "q.toml").write_text("\n".join(lines))
    return tmp_path / "q.toml"


ROW = ("[[training]]", "method = 'oidn/retrained'")


def test_each_entry_becomes_a_command_line_and_a_folder(ran, tmp_path):
    keys = ("frames = 60", "train_spp = [1, 4]", "bf16 = true", "clips = ['a', 'b']")
    later = ("[[training]]", "name = 'later'", "method = 'ours/A2'", "start = 'oidn/retrained'")
    file = write(tmp_path, "[queue]", "at_once = 3", *ROW, *keys, *later)
    rlbench("train", "--queue", file, "--out", "r", "--crop", 32)
    first, second, at_once = ran
    words = "--methods oidn/retrained --out r --frames 60 --clips a --clips b --crop 32"
    assert " ".join(first.words) == f"{words} --train-spp 1,4 --bf16"
    weights = "r/oidn-retrained-1+4spp/retrained.safetensors"
    assert (first.weights, first.frames) == (Path(weights), 60)
    start = f"--crop 32 --start {weights}"
    assert " ".join(second.words) == f"--methods ours/A2 --out r/later {start}"
    assert (second.weights, second.frames) == (Path("r/later/ours-A2/A2.safetensors"), 12_000)
    assert at_once == 3


@pytest.mark.parametrize(("lines", "at_once"), [([], 1), (["[queue]", "at_once = 3"], 3)])
def test_one_training_at_a_time_runs_on_a_gpu_unless_the_file_says_more(
    ran, tmp_path, lines, at_once
):
    file = write(tmp_path, *lines, *ROW)
    rlbench("train", "--queue", file, "--device", "cuda", "--batch", 16)
    assert ran[0].words[-4:] == ("--device", "cuda", "--batch", "16")
    assert ran[1] == at_once


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("eval_intervall = 3", "no option 'eval_intervall'. Did you mean 'eval_interval'?"),
        ("out = 'runs'", "no option 'out'"),
        ("bf16 = 1", "bf16 = 1 is not true or false"),
        (
            "frames = true",
            "'oidn/retrained': Invalid value for '--frames': Input should be a valid integer",
        ),
        ("train_spp = 'lots'", "Invalid value for '--train-spp': 'lots' is no list of budgets"),
        ("[[training]]\nmethod = 'nttas'", "Did you mean 'ntas'?"),
        ("[[training]]\nmethod = 'mean'", "nothing to train: mean has"),
        ("[[training]]\nmethod = 'oidn/*'", "'oidn/*' is a pattern"),
    ],
)
def test_a_mistake_is_an_error_before_anything_starts(ran, tmp_path, line, message):
    file = write(tmp_path, *ROW, line)
    assert message in rlbench("train", "--queue", file, "--out", tmp_path / "r", code=2)
    assert not ran


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-m", "ours", "--status"), "error: --status is of a queue"),
        (("-m", "ours", "--queue"), "--methods has no effect with --queue"),
        (("--restart", "--queue"), "--restart has no effect with --queue"),
    ],
)
def test_options_that_contradict_a_queue_are_refused(tmp_path, words, message):
    file = [write(tmp_path, *ROW)] * (words[-1] == "--queue")
    assert message in rlbench("train", *words, *file, code=2)


def test_a_failed_training_gives_exit_code_1_and_its_error(tmp_path):
    file = write(tmp_path, *ROW, "holdout = 'attic'")
    words = ("train", "--queue", file, "--out", tmp_path / "r")
    output = rlbench(*words, code=1)
    assert "oidn/retrained failed 0 of 12000" in output
    assert "exit code 2: error: " in output
    assert output.endswith("1 failed")
    assert output.endswith(rlbench(*words, "--status"))
