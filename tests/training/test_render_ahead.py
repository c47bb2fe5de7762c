"""Clips that are rendered beside a training: their order, waiting, resuming, and the card."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from rlbench.errors import OptionError
from rlbench.system import paths
from rlbench.training import TrainingConfig, TrainingError, render_ahead, train
from rlbench.training.batches import Batches
from rlbench.training.render_ahead import FurtherClips, RenewedBatches
from rlbench.weights import digest, read_card
from tests.conftest import write_noise
from tests.training.test_loop import KilledError, kill_after

FURTHER = FurtherClips(("train-hard", "train"), 3)
CONFIG = TrainingConfig(frames=24, batch=2, crop=16, sequence_length=3, eval_interval=6)
WRITE = """
import sys, time
from pathlib import Path
from tests.conftest import write_noise
for folder in sys.argv[1:]:
    time.sleep(0.1)  # so that the training waits
    write_noise(Path(folder), h=32, w=32)
"""


@pytest.fixture
def replace_renderer(monkeypatch):
    """A second process writes noise where the renderer would write clips."""
    words = [sys.executable, "-c", WRITE]

    def command(further, preset):
        return [*words, *(str(each) for each in further.folders if each.parent.name == preset)]

    monkeypatch.setattr(render_ahead, "_command", command)


@pytest.fixture
def clips(tmp_path):
    return [write_noise(tmp_path / "first" / name, h=32, w=32) for name in ("one", "two", "three")]


def train_on(clips, out: Path, sequences: int | None = None) -> str:
    """The hash of the weights after a training with further clips."""
    train(
        "oidn/retrained",
        clips,
        clips[:1],
        out,
        CONFIG,
        on_progress=kill_after(sequences),
        further=FURTHER,
    )
    return digest(out / "retrained.safetensors")


def test_each_further_clip_replaces_the_oldest_one(clips, tmp_path):
    batches = Batches(clips, batch=1, crop=16, sequence_length=3, seed=0)
    further = [write_noise(tmp_path / f"further-{n}", h=32, w=32) for n in range(4)]
    renewed, seen = RenewedBatches(batches, further, 2, lambda folder: None), []
    for index in range(10):
        drawn = renewed.sequence(index).frames[0].reference.half_a
        window = [*clips, *further][min(index // 2, 4) :][:3]
        expected = Batches(window, batch=1, crop=16, sequence_length=3, seed=0).sequence(index)
        assert drawn.equal(expected.frames[0].reference.half_a)
        seen.append(len(renewed.digests(index)))
    assert seen == [0, 0, 0, 1, 1, 2, 2, 3, 3, 4]
    later = RenewedBatches(batches, further, 2, lambda folder: None)  # a run that is resumed
    assert later.sequence(9).frames[0].reference.half_a.equal(drawn)


def test_a_killed_training_ends_as_an_undisturbed_one_and_its_card_names_the_clips(
    clips, tmp_path, replace_renderer
):
    with pytest.raises(KilledError):
        train_on(clips, tmp_path / "killed", 3)
    resumed = train_on(clips, tmp_path / "killed")
    assert resumed == train_on(clips, tmp_path / "undisturbed")
    names = [name.split()[0] for name in read_card(tmp_path / "killed/retrained.safetensors").data]
    assert names == ["one", "two", "three", "hard-10000", "generated-10000", "hard-10001"]


def test_a_training_stops_where_a_clip_cannot_be_rendered(clips, tmp_path, monkeypatch):
    script = "print('no such scene'); raise SystemExit(3)"
    monkeypatch.setattr(render_ahead, "_command", lambda *names: [sys.executable, "-c", script])
    with pytest.raises(
        TrainingError, match=r"clip hard-10000 was not rendered.*code 3.*render.log"
    ):
        train_on(clips, tmp_path / "run")
    log = (tmp_path / "run" / render_ahead.LOG).read_text()
    assert set(log.splitlines()) == {"no such scene"}  # of one process or of both


@pytest.mark.parametrize("preset", ["mini", "real", "nothing"])
def test_only_presets_of_generated_scenes_have_further_clips(preset):
    with pytest.raises(OptionError, match=rf"further seeds of presets.*'{preset}' is none"):
        FurtherClips(("train", preset), 5)


def test_further_clips_lie_where_the_command_renders_them():
    words = render_ahead._command(FURTHER, "train-hard")[1:]
    assert words == ["-m", "rlbench", "render", "--preset", "train-hard", "--seeds", "10000:10002"]
    assert FURTHER.folders[0] == paths.clips_folder() / "train-hard" / "hard-10000"


@pytest.mark.slow
def test_a_training_renders_its_further_clips(tmp_path):
    options = ["--preset", "train", "--seeds", "0:2", "--render-ahead", "1", "--frames", "30"]
    words = ["train", "-m", "oidn/retrained", *options, "--out", str(tmp_path)]
    subprocess.run([sys.executable, "-m", "rlbench", *words], check=True)
    (card,) = tmp_path.rglob("retrained.safetensors")
    assert "generated-10000" in str(read_card(card).data)
