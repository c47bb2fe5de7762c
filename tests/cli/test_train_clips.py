"""Training on a user's own clips: from a folder to weights that are measured, or refused."""

from __future__ import annotations

import json
import tomllib
from contextlib import contextmanager
from pathlib import Path

import pytest

from rlbench.cli import console
from rlbench.cli.train import _reproducing_command
from rlbench.clips.stored import open_clip
from rlbench.weights import digest, read_card
from tests.cli.runner import rlbench
from tests.learning_plugin import write_learner
from tests.procedural_folder import write_world

TRAIN = ("train", "-m", "blur", "--crop", 16, "--device", "cpu")


class KilledError(Exception):
    """Stands for a kill."""


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    """Five clips of different sizes and lengths, two of them with fewer samples; the plugin."""
    write_learner(tmp_path)
    for number, (side, frames, spp) in enumerate(
        ((24, 2, 8), (32, 3, 8), (20, 4, 8), (24, 3, 1), (28, 2, 1))
    ):
        folder = write_world(tmp_path / "shots" / f"shot-{number}", number, side, frames)
        text = (folder / "clip.toml").read_text()
        (folder / "clip.toml").write_text(text.replace("pool_spp = 8", f"pool_spp = {spp}"))
    return tmp_path / "shots"


def train(shots: Path, out: Path, *words: object, code: int = 0) -> str:
    plugin = ("--plugin", shots.parent / "blur.py")
    return rlbench(*TRAIN, *plugin, "--clips", shots, "--out", out, *words, code=code)


def test_own_clips_become_weights_that_are_measured(shots, tmp_path):
    output = train(shots, tmp_path / "runs", "--frames", 24, "--batch", 4)
    assert "4 clips train; these validate and are not trained on: clips, 1 (shot-4)" in output
    assert "1 of 4 clips store fewer samples per pixel than the largest budget of 2 (shot-3 1)" in (
        output
    )
    weights = tmp_path / "runs" / "blur" / "blur.safetensors"
    card = read_card(weights)
    clips = [open_clip(shots / f"shot-{number}") for number in range(4)]
    assert list(card.data) == [f"{clip.name} {clip.digest[:12]}" for clip in clips]
    words = ("--plugin", tmp_path / "blur.py", "--weights", weights, "--spp", 1, "--times", "none")
    words += ("--clips", shots / "shot-0", "--out", tmp_path / "r")
    assert "1 cells measured" in rlbench("run", "-m", "blur", *words)


def test_a_card_and_a_status_hold_no_path_of_this_machine(shots, tmp_path):
    train(shots, tmp_path / "runs", "--frames", 6)
    folder = tmp_path / "runs" / "blur"
    for file in ("blur.toml", "status.json", "log.jsonl"):
        assert str(tmp_path) not in (folder / file).read_text()


@pytest.mark.parametrize(
    ("word", "recorded"),
    [
        ("/home/me/a,/home/me/b/", "a,b/"),
        ("real=/data/x", "real=x"),
        ("--out=/runs", "--out=runs"),
        ("runs/a", "runs/a"),
        ("ours/A1,all/*", "'ours/A1,all/*'"),
    ],
)
def test_a_card_records_the_names_of_folders_alone(word, recorded):
    assert _reproducing_command(["train", word]) == f"rlbench train {recorded}"


def test_a_killed_training_on_own_clips_ends_as_an_undisturbed_one(shots, tmp_path, monkeypatch):
    words = ("--frames", 1500, "--batch", 64, "--keep", "best")

    @contextmanager
    def killed(title, frames):
        def on_progress(progress, loss):
            if progress.frames_seen > 1300:
                raise KilledError

        yield on_progress

    with monkeypatch.context() as patch:
        patch.setattr(console, "training", killed)
        train(shots, tmp_path / "killed", *words, code=1)
    assert not (tmp_path / "killed" / "blur" / "blur.safetensors").exists()
    for name in ("killed", "undisturbed"):
        train(shots, tmp_path / name, *words)
    killed_weights, undisturbed = (
        tmp_path / name / "blur" / "blur.safetensors" for name in ("killed", "undisturbed")
    )
    assert digest(killed_weights) == digest(undisturbed)
    assert read_card(killed_weights).curves == read_card(undisturbed).curves


def test_each_validation_set_has_a_curve_on_the_card_and_in_the_log(shots, tmp_path):
    sets = f"{shots}/shot-0,rest={shots}/shot-[12]"
    output = train(shots, tmp_path / "runs", "--frames", 6, "--validate", sets)
    assert "not trained on: shot-0, 1 (shot-0); rest, 2 (shot-1, shot-2)" in output
    folder = tmp_path / "runs" / "blur"
    card = tomllib.loads((folder / "blur.toml").read_text())
    (line,) = (folder / "log.jsonl").read_text().splitlines()
    validation = json.loads(line)["validation"]
    assert set(card["curves"]) == set(validation) == {"shot-0", "rest"}
    for name, ((_, psnr, first),) in card["curves"].items():
        drift = card["drift"][name]
        assert validation[name] == {"psnr": psnr, "first_frames": first, "drift": drift}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--mix", 0.3), "--mix is the share of crops from --clips"),
        (
            ("--mix", 1.5, "--preset", "train"),
            "'1.5' is not a share. Give a number between 0 and 1",
        ),
        (("--crop", 22), "'blur' cannot use 1 of 4 clips"),
        (("--holdout", "hall"), "--holdout trains on test scenes of a preset, and --clips names"),
        (("--quick",), "--quick trains on clips of its own, and --clips chooses others"),
        (("--validate", "unseen"), "--validate unseen: this is a reported test set"),
        (("--keep", "best:real"), "cannot keep 'best:real': validation sets are clips. Choose"),
        (("--keep", "first"), "'first' is none of last, best and best:SET"),
        (("--preset", "train,mini"), "preset 'mini' is a test set"),
    ],
)
def test_what_cannot_be_trained_is_refused_before_the_training(shots, tmp_path, words, message):
    assert message in train(shots, tmp_path / "runs", *words, code=2)
    assert not list((tmp_path / "runs").glob("*/log.jsonl"))


def test_clips_of_a_test_set_are_refused_by_name(shots):
    folder = write_world(shots / "hall")
    header = (folder / "clip.toml").read_text()
    (folder / "clip.toml").write_text(header.replace('preset = ""', 'preset = "standard"'))
    plugin = ("--plugin", shots.parent / "blur.py")
    output = rlbench("train", "-m", "blur", *plugin, "--clips", shots, code=2)
    assert "error: clip 'hall' in" in output
    assert "belongs to preset 'standard', which is scored, so methods must not be trained" in output
