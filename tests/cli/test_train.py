"""The commands train and crossval: options, clips of the user's own, queues of trainings."""

from __future__ import annotations

import json
import tomllib
from contextlib import contextmanager
from pathlib import Path

import pytest

from rlbench.cli import console
from rlbench.cli.train import _reproducing_command
from rlbench.clips.presets import PRESETS
from rlbench.clips.stored import open_clip
from rlbench.training import dataset, queue
from rlbench.training.loop import TrainingRuns
from rlbench.weights import digest, read_card
from tests.cli.runner import rlbench
from tests.learning_plugin import write_learner
from tests.procedural_folder import write_world


def test_no_seed_of_a_test_set_belongs_to_a_training_set():
    seeds = {preset.is_test_set: set(preset.seeds) for preset in PRESETS.values() if preset.seeds}
    assert not seeds[True] & seeds[False]


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
    output = rlbench("train", "-m", "oidn/retrained,oidn/tuned,mean", *words)
    assert "mean has nothing to train" in output
    selection, (runs, *_), _ = calls
    assert [name for _, name, _, _ in calls[1:]] == ["oidn/retrained", "oidn/tuned"]
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
    trained = ["oidn/retrained", "oidn/tuned"]
    assert [name for _, name, _, _ in calls[1:]] == trained


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
        (("--crop", 22), "'blur' cannot use 1 of 4 clips"),
        (("--keep", "best:real"), "cannot keep 'best:real': validation sets are clips. Choose"),
    ],
)
def test_what_these_clips_cannot_train_is_refused_before(shots, tmp_path, words, message):
    assert message in train(shots, tmp_path / "runs", *words, code=2)
    assert not list((tmp_path / "runs").glob("*/log.jsonl"))


def test_clips_of_a_test_set_are_refused_by_name(shots):
    folder = write_world(shots / "hall")
    header = (folder / "clip.toml").read_text()
    (folder / "clip.toml").write_text(header.replace('preset = ""', 'preset = "standard"'))
    output = train(shots, shots.parent / "runs", code=2)
    assert "error: clip 'hall' in" in output
    assert "belongs to preset 'standard', which is scored, so methods must not be trained" in output


@pytest.fixture
def ran(monkeypatch) -> list[queue.Training | int]:
    """The trainings that would run, and how many at once."""
    arguments: list[queue.Training | int] = []

    def record(trainings: list[queue.Training], out: Path, at_once: int, *_: object) -> None:
        arguments.extend([*trainings, at_once])

    monkeypatch.setattr(queue, "run_queue", record)
    return arguments


def write_queue(tmp_path: Path, *lines: str) -> Path:
    (tmp_path / "q.toml").write_text("\n".join(lines))
    return tmp_path / "q.toml"


ROW = ("[[training]]", "method = 'oidn/retrained'")


def test_each_entry_becomes_a_command_line_and_a_folder(ran, tmp_path):
    keys = ("frames = 60", "train_spp = [1, 4]", "bf16 = true", "clips = ['a', 'b']")
    later = ("[[training]]", "name = 'later'", "method = 'ours/A2'", "start = 'oidn/retrained'")
    file = write_queue(tmp_path, "[queue]", "at_once = 3", *ROW, *keys, *later)
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
    file = write_queue(tmp_path, *lines, *ROW)
    rlbench("train", "--queue", file, "--device", "cuda", "--batch", 16)
    assert ran[0].words[-4:] == ("--device", "cuda", "--batch", "16")
    assert ran[1] == at_once


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("out = 'runs'", "no option 'out'"),
        ("bf16 = 1", "bf16 = 1 is not true or false"),
        ("train_spp = 'lots'", "Invalid value for '--train-spp': 'lots' is not a list of budgets"),
        ("[[training]]\nmethod = 'nttas'", "Did you mean 'ntas'?"),
        ("[[training]]\nmethod = 'mean'", "nothing to train: mean has"),
        ("[[training]]\nmethod = 'oidn/*'", "'oidn/*' is a pattern"),
    ],
)
def test_a_mistake_is_an_error_before_anything_starts(ran, tmp_path, line, message):
    file = write_queue(tmp_path, *ROW, line)
    assert message in rlbench("train", "--queue", file, "--out", tmp_path / "r", code=2)
    assert not ran


@pytest.mark.parametrize("words", [("--methods", "ours"), ("--restart",)])
def test_options_that_contradict_a_queue_are_refused(tmp_path, words):
    output = rlbench("train", *words, "--queue", write_queue(tmp_path, *ROW), code=2)
    assert f"{words[0]} has no effect with --queue" in output


def test_a_failed_training_gives_exit_code_1_and_its_error(tmp_path):
    file = write_queue(tmp_path, *ROW, "holdout = 'attic'")
    words = ("train", "--queue", file, "--out", tmp_path / "r")
    output = rlbench(*words, code=1)
    assert "oidn/retrained failed 0 of 12000" in output
    assert "exit code 2: error: " in output
    assert output.endswith("1 failed")
    assert output.endswith(rlbench(*words, "--status"))
