"""The folder of a run: the state that is read from it, and the weights that it holds."""

from __future__ import annotations

import json

import pytest

from rlbench import registry
from rlbench.errors import OptionError
from rlbench.training.run_folder import RunState, find_weights, read_state

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
    assert (state.validation, state.is_finished) == ({"a": 20.5}, False)


def test_weights_are_found_by_file_and_by_run(tmp_path):
    folder = tmp_path / "ours-A2"
    folder.mkdir()
    weights = folder / "A2.safetensors"
    for file in (weights, weights.with_suffix(".toml"), folder / "checkpoint.safetensors"):
        file.touch()
    assert find_weights("ours/A2", tmp_path) == find_weights(str(weights), tmp_path) == weights
    assert find_weights(None, tmp_path) is None
    assert find_weights("ours/A1", tmp_path) == registry.shipped_weights("ours/A1")


@pytest.mark.parametrize("start", ["ours/A2", "dasr/gamma", "unknown"])
def test_weights_that_are_not_there_are_an_error(tmp_path, start):
    (tmp_path / "ours-A2").mkdir()  # a run that is not finished hides the shipped weights
    with pytest.raises(OptionError, match=f"--start {start}: there is no such weights file"):
        find_weights(start, tmp_path)
