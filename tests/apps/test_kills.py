"""Commands that are killed at random moments and repeated end as if nothing had happened."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import pytest

from rlbench.benchmark import results
from rlbench.weights import digest, read_card
from tests.apps.dumps.importers.sources import write_oidn
from tests.conftest import write_noise, write_plugin
from tests.learning_plugin import write_learner

CHECKOUT = Path(__file__).parents[2]
KILLS = 3  # of each command
POLL = 0.005  # seconds

pytestmark = pytest.mark.slow


def start(words: Sequence[object], cache: Path) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "RLBENCH_CACHE": str(cache)}
    command = [sys.executable, "-c", *map(str, words)]
    return subprocess.Popen(
        command, cwd=CHECKOUT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )


def wait(child: subprocess.Popen[bytes]) -> None:
    output, _ = child.communicate()
    assert child.returncode == 0, output.decode()


def snapshot(folder: Path) -> dict[str, int]:
    """Times of all files and folders, temporary ones included; changes while a command works."""
    times = {}
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):
            times[str(path)] = path.stat().st_mtime_ns
    return times


def working_seconds(child: subprocess.Popen[bytes], folder: Path) -> float:
    """The time from a command's first file to its end."""
    while child.poll() is None and not snapshot(folder):
        time.sleep(POLL)
    began = time.monotonic()
    wait(child)
    return time.monotonic() - began


def kill_and_repeat(words: Callable[[Path], Sequence[object]], tmp_path: Path, seed: int) -> int:
    """Run a command undisturbed in one folder; kill it at random in another, then let it end.

    Returns the number of kills that reached a working process.
    """
    undisturbed, killed, moments = (
        tmp_path / "undisturbed",
        tmp_path / "killed",
        random.Random(seed),
    )
    seconds = working_seconds(start(words(undisturbed), tmp_path / "cache"), undisturbed)
    kills = 0
    for _ in range(KILLS):
        before = snapshot(killed)
        child = start(words(killed), tmp_path / "cache")
        while child.poll() is None and snapshot(killed) == before:
            time.sleep(POLL)
        time.sleep(moments.uniform(0, seconds / 2))
        kills += child.poll() is None
        child.send_signal(signal.SIGKILL)
        child.communicate()
    wait(start(words(killed), tmp_path / "cache"))
    return kills


def contents(folder: Path) -> dict[str, object]:
    """All finished files by path; of clip.toml only what does not say when it was written."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name[0] != "."]
    return {path.relative_to(folder).as_posix(): content(path) for path in files}


def content(path: Path) -> object:
    if path.suffix != ".toml":
        return path.read_bytes()
    return {
        k: v
        for k, v in tomllib.loads(path.read_text()).items()
        if not k.startswith(("sample_ms", "sample_p", "gbuffer_ms"))
    }


APP = "from rlbench.cli.app import app; app()"


def test_run(tmp_path):
    for name in ("foyer", "attic"):
        write_noise(tmp_path / "clips" / name, name)
    slow = "import time; time.sleep(0.01); return samples.mean, None"
    plugin = write_plugin(tmp_path / "slow.py", "slow", body=slow)

    def words(out: Path) -> list[object]:
        options = ["--clips", tmp_path / "clips", "--plugin", plugin, "--out", out]
        return [APP, "run", "-m", "slow,mean", *options]

    def scores(folder: Path) -> list[tuple[object, ...]]:
        rows = results.read(folder)
        name = rows["metric"].str
        kept = rows[~(name.endswith("_ms") | name.startswith("clock_"))]
        return sorted(kept.itertuples(index=False, name=None), key=repr)

    assert kill_and_repeat(words, tmp_path, 1)
    assert scores(tmp_path / "killed") == scores(tmp_path / "undisturbed")


def test_import(tmp_path):
    source = write_oidn(tmp_path / "walk", frames=40)

    def words(out: Path) -> list[object]:
        return [APP, "import", source, "--format", "oidn", "--out", out]

    assert kill_and_repeat(words, tmp_path, 2)
    assert contents(tmp_path / "killed") == contents(tmp_path / "undisturbed")


RENDER = """
import sys
from pathlib import Path
from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.render_clips import render_clip
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.clips.presets import Preset
from tests.apps.render.small_scenes import room
select_variant()
preset = Preset("test", "tests", (16, 24), frames=8, reference_spp=16, pool_spp=3)
job = Job("room", room(), preset, Path(sys.argv[1]))
if not job.is_finished:
    render_clip(job)
"""


def test_render(tmp_path):
    assert kill_and_repeat(lambda out: [RENDER, out], tmp_path, 3)
    killed, undisturbed = contents(tmp_path / "killed"), contents(tmp_path / "undisturbed")
    assert killed.keys() == undisturbed.keys()
    assert [name for name in killed if killed[name] != undisturbed[name]] == []


TRAIN = """
import sys
from pathlib import Path
import torch
from rlbench import registry
from rlbench.training import TrainingConfig, train
torch.set_num_threads(1)
plugin, clip, own, out = map(Path, sys.argv[1:])
registry.use_plugin(plugin)
options = {"sequence_length": 3, "eval_interval": 6, "mix": 0.3, "keep": "best"}
config = TrainingConfig(frames=120, crop=16, **options)
train("blur", [clip], {"clip": [clip], "own": [own]}, out, config, mixed_in=[own])
"""


def test_train(tmp_path):
    plugin = write_learner(tmp_path)
    clip = write_noise(tmp_path / "clips" / "noise", h=24, w=24)
    own = write_noise(tmp_path / "clips" / "own", h=32, w=20, frames=4)
    assert kill_and_repeat(lambda out: [TRAIN, plugin, clip, own, out], tmp_path, 4)
    killed, undisturbed = (
        tmp_path / name / "blur.safetensors" for name in ("killed", "undisturbed")
    )
    assert digest(killed) == digest(undisturbed)
    card, expected = read_card(killed), read_card(undisturbed)
    assert card.validation_history == expected.validation_history
    assert (card.curves, card.kept_at) == (expected.curves, expected.kept_at)
    assert (card.frames_seen, card.steps) == (expected.frames_seen, expected.steps)
