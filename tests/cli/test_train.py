"""The commands train and crossval: what they hand over, and what they refuse."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rlbench.clips.presets import PRESETS
from rlbench.training import dataset
from rlbench.training.loop import TrainingRuns
from rlbench.weights import read_card
from tests.cli.runner import rlbench
from tests.learning_plugin import write_learner
from tests.procedural_folder import write_world


def test_clips_that_cannot_be_trained_on_are_refused():
    words = ("train", "-m", "oidn/retrained")
    message = "--seeds 400, 401: these belong to test set 'unseen'"
    assert message in rlbench(*words, "--seeds", "390:402", code=2)
    for preset in ("tiny", "mini-640x360", "standard", "paper", "development", "unseen"):
        output = rlbench(*words, "--preset", preset, code=2)
        assert f"error: preset '{preset}' is a test set" in output
        assert "Choose: train, train-eventful, train-hard, train-real, train-windows" in output


def test_no_seed_of_a_test_set_belongs_to_a_training_set():
    seeds = {preset.is_test_set: set(preset.seeds) for preset in PRESETS.values() if preset.seeds}
    assert not seeds[True] & seeds[False]


@pytest.mark.parametrize("command", ["train", "crossval"])
@pytest.mark.parametrize(
    ("budget", "message"),
    [
        ("0.5", "'ntas' cannot be trained at 0.5 spp: supports 1 to 8 spp"),
        ("lots", "Invalid value for '--train-spp': 'lots' is no list of budgets"),
    ],
)
def test_an_impossible_training_budget_is_refused_before_rendering(command, budget, message):
    assert message in rlbench(command, "-m", "ntas", "--train-spp", budget, code=2)


@pytest.mark.parametrize("command", ["train", "crossval"])
@pytest.mark.parametrize(
    "words", [("--max-grad-norm", "-1"), ("--max-grad-norm", "0"), ("--minutes", "0")]
)
def test_numbers_that_train_nothing_are_refused(command, words, tmp_path):
    output = rlbench(command, "-m", "oidn/retrained", "--out", tmp_path / "runs", *words, code=2)
    assert f"Invalid value for '{words[0]}': '{words[1]}' is not a number above 0" in output
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("name", ["oidn", "oidn/fast"])
def test_training_a_row_with_published_weights_by_its_name_is_refused(name, tmp_path):
    output = rlbench("train", "-m", f"mean,{name}", "--out", tmp_path / "runs", code=2)
    assert f"error: {name} has weights that Intel trained and published, so rlbench" in output
    assert output.endswith("to train: oidn/retrained, oidn/retrained-small, oidn/tuned")
    assert not (tmp_path / "runs").exists()


@pytest.fixture
def calls(monkeypatch):
    """The clips that would be rendered, and the runs that would be trained."""
    runs = []

    def select(*arguments):
        clips = [Path("never rendered")]
        runs.append(arguments)
        return dataset.TrainingSplit(clips, {"train": clips})

    monkeypatch.setattr(dataset, "select_split", select)

    def record(self, name, split, held_out_scene=None):
        runs.append((self, name, split, held_out_scene))
        return self.out / "never trained.safetensors"

    monkeypatch.setattr(TrainingRuns, "train", record)
    return runs


def test_train_hands_over_its_options(calls, tmp_path):
    words = ("--frames", 60, "--batch", 2, "--crop", 32, "--train-spp", "1,4", "--bf16")
    words += ("--max-grad-norm", 0.5, "--seed", 3, "--minutes", 2, "--allow-config-change")
    words += ("--device", "cpu", "--out", tmp_path, "--seeds", "0:3", "--preset", "train")
    words += ("--render-ahead", 7)
    output = rlbench("train", "-m", "oidn/retrained,oidn/retrained-small,mean", *words)
    assert "mean has nothing to train" in output
    selection, (runs, *_), _ = calls
    assert [name for _, name, _, _ in calls[1:]] == ["oidn/retrained", "oidn/retrained-small"]
    config = runs.config
    assert (config.frames, config.batch, config.crop, config.spp) == (60, 2, 32, (1, 4))
    assert (config.bf16, config.max_grad_norm, config.seed) == (True, 0.5, 3)
    assert (runs.out, runs.device, runs.suffix) == (tmp_path, "cpu", "")
    assert 1.9 < runs.minutes < 2
    assert runs.allow_config_change
    assert selection[:4] == ("train", (0, 1, 2), None, {"path"})
    assert selection[5:] == ([], [], 7)
    assert calls[1][3] is None


def test_a_pattern_leaves_out_rows_with_published_weights_and_says_so(calls):
    output = rlbench("train", "-m", "oidn/*")
    assert "oidn has weights that Intel trained and published" in output
    assert "oidn/fast has weights that Intel trained and published" in output
    trained = ["oidn/retrained", "oidn/retrained-small", "oidn/tuned"]
    assert [name for _, name, _, _ in calls[1:]] == trained


def test_the_defaults_of_train_are_those_of_the_config(calls):
    rlbench("train", "-m", "oidn/retrained")
    split, (runs, *_) = calls
    assert runs.config == type(runs.config)()
    assert runs.minutes == math.inf
    assert not runs.allow_config_change
    assert split[:4] == (None, None, None, {"path"})
    assert split[5:] == ([], [], 0)


@pytest.mark.parametrize("words", [("--seeds", "3"), ("--preset", "train"), ("--holdout", "hall")])
def test_a_quick_training_has_clips_of_its_own(words):
    output = rlbench("train", "-m", "ntas", "--quick", *words, code=2)
    assert f"--quick trains on clips of its own, and {words[0]} chooses others" in output


def test_a_quick_training_renders_nothing_and_its_card_and_rows_say_so(tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "QUICK_CLIPS", 3)
    monkeypatch.setattr(dataset, "QUICK_SIDE", 32)
    plugin, out = ("--plugin", write_learner(tmp_path)), tmp_path / "runs"
    words = ("--quick", "--frames", 12, "--crop", 32, "--device", "cpu", "--out", out)
    output = rlbench("train", "-m", "blur", *plugin, *words)
    assert "quick: trained on procedural clips, to try the training, not for results" in output
    weights = out / "blur-quick" / "blur.safetensors"
    assert read_card(weights).note.startswith("quick: trained on procedural clips")
    assert [clip.split()[0] for clip in read_card(weights).data] == ["procedural-0"]
    words = ("--weights", weights, "--spp", 1, "--times", "none", "--out", tmp_path / "r")
    clip = write_world(tmp_path / "clips" / "world", seed=5)
    output = rlbench("run", "-m", "blur", *plugin, "--clips", clip, *words)
    assert "blur: quick: trained on procedural clips, to try the training, not" in output


def test_rendering_that_comes_first_is_announced(calls):
    output = rlbench("train", "-m", "oidn/retrained", "--seeds", "0:3", "--device", "cpu")
    assert "3 of 3 training clips have to be rendered first. --quick tries the training" in output


def test_rendering_counts_as_time_of_a_training(calls, monkeypatch):
    def render(*arguments):
        executor = arguments[4]
        return [result.value for result in executor.map(lambda job, _: job, [1, 2])]

    monkeypatch.setattr(dataset, "select_split", render)
    output = rlbench("train", "-m", "oidn/retrained", "--minutes", "1e-9", code=2)
    assert "error: 1e-09 minutes are over, and 1 of 2 jobs are not done" in output
    assert calls == []


def test_restart_archives_the_old_run(calls, tmp_path):
    (tmp_path / "oidn-retrained").mkdir()
    words = ("train", "-m", "oidn/retrained", "--out", tmp_path)
    assert "old" not in rlbench(*words, "--resume").replace(str(tmp_path), "")
    output = rlbench(*words, "--restart")
    assert f"oidn/retrained: the old run is now in {tmp_path}/oidn-retrained.old-1" in output
    assert (tmp_path / "oidn-retrained.old-1").is_dir()
