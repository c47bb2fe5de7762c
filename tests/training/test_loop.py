"""The training loop: runs that are killed and resumed, refused or finished; budgets; files."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import safetensors.torch
import torch

from rlbench import registry
from rlbench.training import TrainingConfig, TrainingError, checkpoint, run_folder, train
from rlbench.training.dataset import TrainingSplit
from rlbench.training.loop import TrainingRuns, archive_run
from rlbench.training.train_state import SetScore, TrainState
from rlbench.weights import ModelCard, digest, read_card
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

CHECKOUT = Path(__file__).parents[2]
OIDN = TrainingConfig(frames=24, batch=2, crop=16, sequence_length=3, eval_interval=12)


class KilledError(Exception):
    """Stands for a kill."""


def kill_after(sequences: int | None):
    """A callback that stops a run after a number of sequences."""

    def on_progress(progress, loss):
        if progress.sequences == sequences:
            raise KilledError

    return on_progress


def train_oidn(
    out: Path, clip: Path, sequences: int | None = None, row: str = "retrained", anchor: float = 0.0
) -> tuple[ModelCard, str]:
    """OIDN trained on four sequences of a tiny clip; its card and the hash of its weights."""
    config = replace(OIDN, anchor=anchor)
    train(f"oidn/{row}", [clip], [clip], out, config, on_progress=kill_after(sequences))
    return read_card(out / f"{row}.safetensors"), digest(out / f"{row}.safetensors")


@pytest.mark.parametrize("chosen", [("retrained", 0.0), ("tuned", 30.0)], ids=str)
def test_a_killed_run_ends_as_an_undisturbed_one(tmp_path, chosen):
    clip = write_noise(tmp_path / "clips" / "noise", h=32, w=32)
    with pytest.raises(KilledError):  # one sequence after the only checkpoint
        train_oidn(tmp_path / "killed", clip, 3, *chosen)
    resumed, resumed_hash = train_oidn(tmp_path / "killed", clip, None, *chosen)
    card, expected_hash = train_oidn(tmp_path / "undisturbed", clip, None, *chosen)
    assert resumed_hash == expected_hash
    assert (resumed.frames_seen, resumed.steps) == (card.frames_seen, card.steps) == (24, 12)
    assert resumed.validation_history == card.validation_history


CHILD = """
import os, signal, sys
from pathlib import Path
import torch
from rlbench.training import TrainingConfig, train
torch.set_num_threads(1)
out, clip, kill = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
def on_progress(progress, loss):
    if progress.sequences == kill:
        os.kill(os.getpid(), signal.SIGKILL)
config = TrainingConfig(frames=24, batch=2, crop=16, sequence_length=3, eval_interval=12)
train("oidn/retrained", [clip], [clip], out, config, on_progress=on_progress)
"""


@pytest.mark.slow
def test_kill_9_does_not_change_the_weights(tmp_path):
    """Killed before the first checkpoint and between two, and resumed by another process."""
    clip = write_noise(tmp_path / "clips" / "noise", h=32, w=32)
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(CHECKOUT)}
    for kill in (1, 3):
        command = [sys.executable, "-c", CHILD, tmp_path / "killed", clip, str(kill)]
        assert subprocess.run(command, env=environment).returncode == -signal.SIGKILL
    assert not (tmp_path / "killed" / "retrained.safetensors").exists()
    resumed, resumed_hash = train_oidn(tmp_path / "killed", clip)
    card, expected_hash = train_oidn(tmp_path / "undisturbed", clip)
    assert resumed_hash == expected_hash
    assert resumed.validation_history == card.validation_history


CRITIC = "torch.nn.Conv2d(3, 1, 1)"
CRITIC_LOSS = "loss + (auxiliary(result.image) - loss.detach()).square().mean()"


def test_an_auxiliary_network_is_in_checkpoints_and_not_in_the_weights_file(tmp_path):
    registry.use_plugin(write_learner(tmp_path, CRITIC_LOSS, CRITIC))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    config = TrainingConfig(24, crop=16, sequence_length=3, eval_interval=6)

    def run(out, sequences=None):
        train("blur", [clip], [clip], out, config, on_progress=kill_after(sequences))
        tensors = checkpoint.read(out / "checkpoint.safetensors")[1]
        critic = checkpoint.select_prefix("auxiliary_network.", tensors)
        return digest(out / "blur.safetensors"), critic

    with pytest.raises(KilledError):
        run(tmp_path / "killed", 5)  # one sequence after a checkpoint
    resumed_hash, resumed_critic = run(tmp_path / "killed")
    expected_hash, expected_critic = run(tmp_path / "whole")
    assert resumed_hash == expected_hash
    assert set(resumed_critic) == {"weight", "bias"}
    assert all(torch.equal(resumed_critic[name], expected_critic[name]) for name in resumed_critic)
    weights = safetensors.torch.load_file(tmp_path / "whole" / "blur.safetensors")
    assert {name: list(tensor.shape) for name, tensor in weights.items()} == {
        "weight": [3, 3, 3, 3],
        "bias": [3],
    }


def score_validations(monkeypatch, scores: Mapping[int, float]) -> None:
    """Give the validations of a real training these PSNRs, by step of the optimiser."""
    validate = TrainState.validate

    def scored(state, sets):
        result = validate(state, sets)
        return result._replace(sets={"own": SetScore(scores[state.steps], 19.0, 0.0)})

    monkeypatch.setattr(TrainState, "validate", scored)


def test_sigterm_ends_a_training_behind_a_checkpoint(tmp_path):
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    config = TrainingConfig(24, crop=16, sequence_length=3, eval_interval=12)

    def run(out, stops_at=None):
        def stop(progress, loss):
            if progress.sequences == stops_at:
                os.kill(os.getpid(), signal.SIGTERM)

        return train("blur", [clip], [clip], tmp_path / out, config, on_progress=stop).weights

    with pytest.raises(SystemExit, match=str(128 + signal.SIGTERM)):
        run("stopped", stops_at=5)
    metadata, _ = checkpoint.read(tmp_path / "stopped" / "checkpoint.safetensors")
    assert metadata["frames_seen"] == 15  # between two validations
    assert digest(run("stopped")) == digest(run("undisturbed"))


def test_the_weights_of_the_best_validation_are_kept_and_a_kill_loses_none(tmp_path, monkeypatch):
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    averages = {}
    update = TrainState.keep_average

    def recorded(self):
        update(self)
        averages[self.steps] = {k: v.clone() for k, v in self.average.state_dict().items()}

    monkeypatch.setattr(TrainState, "keep_average", recorded)
    score_validations(monkeypatch, {6: 20.0, 12: 25.0, 18: 22.0, 24: 21.0})
    config = TrainingConfig(24, crop=16, sequence_length=3, eval_interval=6, keep="best:own")
    arguments = ("blur", [clip], {"own": [clip]}, tmp_path / "run", config)
    with pytest.raises(KilledError):
        train(*arguments, on_progress=kill_after(7))
    result = train(*arguments)
    card = read_card(result.weights)
    assert (card.frames_seen, card.kept_at) == (24, 12)
    assert card.note.startswith("kept: best:own, 25.00 dB after 12 of 24 frames")
    assert card.curves["own"][1] == (12, 25.0, 19.0)
    stored = safetensors.torch.load_file(result.weights)
    expected = {name: tensor.half() for name, tensor in averages[12].items()}
    torch.testing.assert_close(stored, expected, rtol=0, atol=0)


@pytest.mark.parametrize(
    ("scores", "most", "seen", "trend"),
    [
        ({6: 20.0, 12: 20.04}, 96, 12, "flat"),
        ({6: 20.0, 12: 21.0, 24: 21.5, 48: 21.52}, 96, 48, "flat"),
        ({6: 20.0, 12: 21.0, 24: 22.0}, 47, 24, "rising"),
    ],
)
def test_cycles_double_until_one_gains_too_little_and_a_kill_changes_nothing(
    tmp_path, monkeypatch, scores, most, seen, trend
):
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    score_validations(monkeypatch, scores)
    config = TrainingConfig(
        6, crop=16, sequence_length=3, eval_interval=1000, until_flat=0.05, most_frames=most
    )

    def run(folder: Path, sequences: int | None = None):
        sets = {"own": [clip]}
        return train("blur", [clip], sets, folder, config, on_progress=kill_after(sequences))

    with pytest.raises(KilledError):
        run(tmp_path / "killed", 3)  # in the second cycle
    resumed, undisturbed = run(tmp_path / "killed"), run(tmp_path / "undisturbed")
    assert digest(resumed.weights) == digest(undisturbed.weights)
    card = read_card(resumed.weights)
    assert [frames for frames, _ in card.validation_history] == sorted(scores)
    assert (card.frames_seen, card.trend) == (seen, trend)
    assert ("not converged" in card.note) == (trend == "rising")
    before = resumed.weights.stat().st_mtime_ns
    assert run(tmp_path / "killed").progress.cycles == undisturbed.progress.cycles
    assert resumed.weights.stat().st_mtime_ns == before  # a finished run is left unchanged


def test_a_training_until_it_is_flat_needs_validations_and_no_minutes(tmp_path):
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    with pytest.raises(TrainingError, match="no clips to validate"):
        train("blur", [clip], {}, tmp_path, TrainingConfig(until_flat=0.05))
    with pytest.raises(TrainingError, match="--anneal 2 ends .* Give one of them"):
        TrainingConfig(anneal=2.0, until_flat=0.05)


@pytest.mark.parametrize("keep", ["best:other", "worst"])
def test_weights_cannot_be_kept_by_a_set_that_does_not_exist(tmp_path, keep):
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    with pytest.raises(TrainingError, match=f"'{keep}': validation sets are own. Choose last, b"):
        train("blur", [clip], {"own": [clip]}, tmp_path, TrainingConfig(keep=keep))


def test_other_programs_read_the_state_of_a_run_from_its_folder(tmp_path):
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    config = TrainingConfig(12, crop=16, sequence_length=3, eval_interval=6)
    sets = {"one": [clip], "two": [clip]}
    result = train("blur", [clip], sets, tmp_path / "run", config)
    status = json.loads((tmp_path / "run" / run_folder.STATUS).read_text())
    last = json.loads((tmp_path / "run" / run_folder.LOG).read_text().splitlines()[-1])
    assert (status["method"], status["frames"], status["frames_seen"]) == ("blur", 12, 12)
    assert status["finished"]
    assert status["validation"] == last["validation"]
    assert set(status["validation"]) == {"one", "two"}
    _, psnr, first = result.progress.curves["one"][-1]
    drift = result.progress.drift["one"]
    assert status["validation"]["one"] == {"psnr": psnr, "first_frames": first, "drift": drift}
    assert read_card(result.weights).drift == result.progress.drift


@pytest.mark.parametrize(
    ("spp", "expected"), [((), {1.0, 2.0}), ((4.0,), {4.0}), ((1.5, 3.0), {1.5, 3.0})]
)
def test_budgets_are_those_of_the_config_or_the_methods_own_and_are_in_the_card(
    tmp_path, monkeypatch, spp, expected
):
    budgets = set()
    train_sequence = TrainState.train_sequence

    def recorded(self, clip, spp, lr_factor, fraction_done):
        budgets.add(spp)
        return train_sequence(self, clip, spp, lr_factor, fraction_done)

    monkeypatch.setattr(TrainState, "train_sequence", recorded)
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "noise", h=24, w=24)
    config = TrainingConfig(24, crop=16, sequence_length=3, spp=spp)
    result = train("blur", [clip], [clip], tmp_path / "run", config)
    assert budgets == expected
    stored = json.loads(read_card(result.weights).training_config)
    assert set(stored["spp"]) == expected
    assert stored["max_lr"] == 1e-2


@pytest.mark.parametrize("spp", [0.5, 8.0])
def test_a_budget_that_the_method_does_not_support_is_refused(tmp_path, spp):
    registry.use_plugin(write_learner(tmp_path))
    config = TrainingConfig(spp=(2.0, spp))
    message = f"'blur' cannot be trained at {spp:g} spp: supports 1 to 4 spp"
    for refused in (
        lambda: train("blur", [], [], tmp_path, config),
        lambda: TrainingRuns(tmp_path, config).check(["blur"]),
    ):
        with pytest.raises(TrainingError, match=message):
            refused()


@pytest.mark.parametrize(
    ("row", "side", "config", "message"),
    [
        (
            "retrained",
            32,
            TrainingConfig(frames=48, crop=16),
            "changed: batch 2 -> 1; eval_interval 12 -> 1000; frames 24 -> 48; sequence_length 3",
        ),
        ("retrained", 40, OIDN, r"changed: data \['clip-32 .* -> \['clip-40"),
        ("tuned", 32, OIDN, "belongs to method 'oidn/retrained', but 'oidn/tuned'"),
    ],
    ids=["config", "clips", "method"],
)
def test_a_checkpoint_of_another_training_is_refused(tmp_path, row, side, config, message):
    clips = {w: write_noise(tmp_path / f"clip-{w}", h=32, w=w) for w in (32, 40)}
    train_oidn(tmp_path / "run", clips[32])
    arguments = (f"oidn/{row}", [clips[side]], [clips[side]], tmp_path / "run", config)
    with pytest.raises(TrainingError, match=message):
        train(*arguments, allow_config_change=row != "retrained")


def test_a_finished_run_keeps_its_card(tmp_path):
    clip = write_noise(tmp_path / "clips" / "noise", h=32, w=32)
    for command in ("first", "second"):
        result = train("oidn/retrained", [clip], [clip], tmp_path, OIDN, command=command)
    assert result.progress.frames_seen == 24
    assert read_card(tmp_path / "retrained.safetensors").command == "first"


@pytest.mark.parametrize("left", ["no card", "another card", "older weights"])
def test_a_run_that_was_killed_while_it_wrote_its_weights_writes_them(tmp_path, left):
    clip, out = write_noise(tmp_path / "clips" / "noise", h=32, w=32), tmp_path / "run"
    if left == "older weights":  # a run with little time saves the weights that it has
        train("oidn/retrained", [clip], [clip], out, OIDN, minutes=1e-9)
    older = [(file, file.read_bytes()) for file in out.glob("retrained.*")]
    train("oidn/retrained", [clip], [clip], out, OIDN)
    expected, card = digest(out / "retrained.safetensors"), out / "retrained.toml"
    if left == "no card":
        card.unlink()
    if left == "another card":
        card.write_text(card.read_text().replace(expected, "0" * 64))
    for file, content in older:
        file.write_bytes(content)
    train("oidn/retrained", [clip], [clip], out, OIDN)
    assert read_card(out / "retrained.safetensors").sha256 == expected
    assert digest(out / "retrained.safetensors") == expected


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


def test_training_shows_its_progress_in_the_given_bar(tmp_path):
    registry.use_plugin(write_learner(tmp_path))
    clip = write_noise(tmp_path / "clips" / "noise", h=24, w=24)
    calls: list[tuple[str, int]] = []

    @contextmanager
    def bar(title: str, frames: int):
        calls.append((title, frames))
        yield lambda progress, loss: calls.append(("done", progress.frames_seen))

    config = TrainingConfig(frames=6, crop=16, sequence_length=3)
    runs = TrainingRuns(tmp_path / "runs", config, progress_bar=bar)
    weights = runs.train("blur", TrainingSplit([clip], {"noise": [clip]}))
    assert weights == tmp_path / "runs" / "blur" / "blur.safetensors"
    assert weights.exists()
    assert calls == [("blur", 6), ("done", 3), ("done", 6)]
