"""A queue of trainings: what its file may say, and what runs, waits, fails, ends and resumes."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from rlbench.system.folder_lock import FolderInUseError
from rlbench.training import queue
from rlbench.training.queue import QueueError, Training, read_attempt, read_queue, run_queue
from rlbench.training.run_folder import read_state
from rlbench.weights import read_card
from tests.cli.runner import CHECKOUT
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

KNOWN = ["frames", "crop", "start"]
TIMEOUT_S = 120.0  # on a busy machine, a process takes long to import torch
ROWS = "[[training]]\nmethod = 'a'\nafter = 'b'\n[[training]]\nmethod = 'b'\n"


def read(tmp_path: Path, text: str) -> tuple[list[queue.Entry], int | None]:
    (tmp_path / "q.toml").write_text(text)
    return read_queue(tmp_path / "q.toml", KNOWN)


def test_an_entry_has_the_defaults_that_it_does_not_replace(tmp_path):
    text = "[queue]\nat_once = 3\nframes = 9\ncrop = 16\n[[training]]\nmethod = 'a'\ncrop = 32\n"
    (entry,), at_once = read(tmp_path, text)
    assert at_once == 3
    assert entry.options == {"frames": 9, "crop": 32}


def test_an_entry_comes_after_the_one_that_it_starts_from(tmp_path):
    start = "[[training]]\nname = 'c'\nmethod = 'a'\nstart = 'a'\n"
    entries, _ = read(tmp_path, start + ROWS + "[[training]]\nmethod = 'd'\n")
    after = {entry.name: entry.after for entry in entries}
    assert list(after.items()) == [("b", ()), ("a", ("b",)), ("c", ("a",)), ("d", ())]
    (own,), _ = read(tmp_path, "[[training]]\nmethod = 'a'\nstart = 'a'\n")
    assert own.after == ()  # from shipped weights


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[queue]\nframse = 3\n" + ROWS, r"\[queue\]: no option 'framse'.*Did you mean 'frames'"),
        (ROWS + "crpo = 3", r"training 2 \(b\): no option 'crpo'.*Did you mean 'crop'"),
        (ROWS + "after = 'a'", "trainings wait for each other, none can be first: a, b"),
        (ROWS + "after = 'x'", "'b': no training 'x' to come after; available: a, b"),
        (ROWS + "name = 'a'", "two trainings are named 'a'"),
        (ROWS + "after = 3", "name and after are names in quotes"),
        ("[queue]\nat_once = 0\n" + ROWS, "at_once = 0 is not a number of processes"),
        ("[[training]]\nframes = 3", "training 1: write its method"),
        ("[queue]\nframes = 3", "is not a queue: write one table"),
        ("[quueue]\n" + ROWS, "is not a queue: write one table"),
        ("frames", "the queue cannot be read: .* is not TOML"),
    ],
)
def test_a_mistake_in_the_file_is_named(tmp_path, text, message):
    with pytest.raises(QueueError, match=message):
        read(tmp_path, text)


@pytest.fixture(scope="module")
def words(tmp_path_factory) -> tuple[str, ...]:
    """Options of a training of one kernel on one small clip."""
    folder = tmp_path_factory.mktemp("words")
    clip, plugin = write_noise(folder / "noise", h=24, w=24), write_learner(folder)
    words = ("--plugin", str(plugin), "--clips", str(clip), "--device", "cpu")
    return (*words, "--crop", "16", "--eval-interval", "30")


def prepare(out: Path, name: str, words: tuple[str, ...], *more: str, after=()) -> Training:
    """A training in `out/name`."""
    words = ("-m", "blur", "--out", str(out / name), *words, *more)
    weights = out / name / "blur" / "blur.safetensors"
    return Training(name, words, weights, 60, tuple(after))


@pytest.fixture(scope="module")
def finished(tmp_path_factory, words) -> Iterator[tuple[dict[str, Training], Path, list[str]]]:
    """Trainings that ran, by name, their folder, and what was said: one failed, one waits."""
    out = tmp_path_factory.mktemp("finished")
    first = prepare(out, "first", words, "--frames", "60")
    start = ("--frames", "60", "--start", str(first.weights))
    trainings = [
        prepare(out, "third", words, *start, after=["first"]),
        prepare(out, "fails", words, "--crop", "4000"),
        prepare(out, "waits", words, after=["fails"]),
        first,
    ]
    events: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(out / "cache"))
        run_queue(trainings, out, 2, on_event=events.append)
        yield {training.name: training for training in trainings}, out, events


def test_a_failed_training_is_reported_and_stops_none_but_those_after_it(finished):
    trainings, *_ = finished
    attempts = {name: read_attempt(training) for name, training in trainings.items()}
    message = attempts["fails"][1]
    assert message.startswith("exit code 2: error: 'blur' cannot use 1 of 1 clips")
    assert [state for state, _ in attempts.values()] == ["done", "failed", "waiting", "done"]


def test_a_training_starts_from_the_weights_of_the_one_before_it(finished):
    trainings, _, events = finished
    order = [line.partition(";")[0] for line in events]
    assert order.index("first: done") < order.index("third: started")
    origin = read_card(trainings["third"].weights).origin
    assert re.fullmatch(r"blur after 60 frames, \w{12} \(2 of 2 tensors\)", origin)


def test_a_second_call_skips_what_is_done_and_retries_what_failed(finished):
    trainings, out, _ = finished
    events: list[str] = []
    run_queue(list(trainings.values()), out, 1, on_event=events.append)
    assert [line.partition(":")[0] for line in events if ": started" in line] == ["fails"]


def test_a_training_with_other_options_has_yet_to_run(finished):
    trainings, *_ = finished
    for name in ("first", "fails"):
        words = (*trainings[name].words, "--seed", "1")
        assert read_attempt(replace(trainings[name], words=words)) == ("waiting", "")


def wait_until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not holds():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.05)


class Campaign:
    """A queue on the command line, in a process of its own, with a training that never ends."""

    def __init__(self, out: Path, words: tuple[str, ...]) -> None:
        self.out = out
        self.training = Training("blur", (), out / "blur" / "blur.safetensors", 10**6)
        (out / "q.toml").write_text("[[training]]\nmethod = 'blur'\nframes = 1_000_000\n")
        options = ("--queue", str(out / "q.toml"), "--out", str(out), *words)
        self.command = [sys.executable, "-m", "rlbench", "train", *options]

    def start(self) -> None:
        """Start, and wait until the training has written a checkpoint, or one more."""
        before = len(self.log())
        environment = os.environ | {"RLBENCH_CACHE": str(self.out / "cache")}
        # as in a terminal: shells let jobs in the background ignore SIGINT, and tests may be one
        listen = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
        self.process = subprocess.Popen(
            self.command, cwd=CHECKOUT, env=environment, preexec_fn=listen
        )
        wait_until(lambda: len(self.log()) > before or self.process.poll() is not None)

    def state(self) -> str:
        return read_attempt(self.training)[0]

    def log(self) -> list[str]:
        """A line for each checkpoint."""
        file = self.training.weights.with_name("log.jsonl")
        return file.read_text().splitlines() if file.exists() else []


@pytest.fixture(scope="module")
def campaign(tmp_path_factory, words) -> Iterator[Campaign]:
    running = Campaign(tmp_path_factory.mktemp("campaign"), words)
    running.start()
    yield running
    running.process.kill()
    running.process.wait()


def test_the_status_is_read_while_the_queue_runs(campaign):
    assert (campaign.state(), campaign.process.poll()) == ("running", None)
    before = read_state(campaign.training.output.parent).frames_seen
    wait_until(lambda: read_state(campaign.training.output.parent).frames_seen > before)


def test_one_queue_runs_in_a_folder(campaign):
    with pytest.raises(FolderInUseError, match="another rlbench"):
        run_queue([campaign.training], campaign.out, 1)


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, *(pytest.param(n, marks=pytest.mark.slow) for n in (15, 2))]
)
def test_a_killed_queue_leaves_no_process_and_resumes(campaign, number):
    campaign.process.send_signal(number)
    campaign.process.wait(TIMEOUT_S)
    wait_until(lambda: campaign.state() == "waiting")
    assert not [line for line in _command_lines() if str(campaign.out) in line]
    log = campaign.log()
    campaign.start()
    assert campaign.state() == "running"
    assert campaign.log()[: len(log) - 1] == log[:-1]  # the last line may be behind the checkpoint


def _command_lines() -> Iterator[str]:
    """The command lines of all processes."""
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # it has ended
            yield file.read_bytes().replace(b"\0", b" ").decode()
