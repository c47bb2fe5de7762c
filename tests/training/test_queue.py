"""A queue of trainings: what its file may say, and what runs, waits, fails, pauses and resumes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rlbench.system.folder_lock import FolderInUseError
from rlbench.training import queue
from rlbench.training.queue import Queue, QueueError, RowStatus, Training, read_queue, read_status
from rlbench.weights import read_card
from tests.cli.runner import CHECKOUT
from tests.conftest import write_noise
from tests.learning_plugin import write_learner

KNOWN = ["frames", "crop", "start"]
TIMEOUT_S = 120.0  # on a busy machine, a process takes long to import torch
# runs a queue in a process of its own, at normal priority: a test does not wait for free processors
RUN = """
import sys
from pathlib import Path
from rlbench.training import queue
queue._use_spare_time = lambda: None
words = tuple(sys.argv[3:])
training = queue.Training("blur", "blur", words, Path(sys.argv[2]), 10**6)
queue.Queue([training], Path(sys.argv[1]), 1).run()
"""


def read(tmp_path: Path, text: str) -> queue.QueueFile:
    (tmp_path / "q.toml").write_text(text)
    return read_queue(tmp_path / "q.toml", KNOWN)


ROWS = "[[training]]\nmethod = 'a'\nafter = 'b'\n[[training]]\nmethod = 'b'\n"


def test_an_entry_has_the_defaults_that_it_does_not_replace(tmp_path):
    text = "[queue]\nat_once = 3\nframes = 9\ncrop = 16\n[[training]]\nmethod = 'a'\ncrop = 32\n"
    content = read(tmp_path, text)
    assert content.at_once == 3
    assert content.entries[0].options == {"frames": 9, "crop": 32}


def test_an_entry_comes_after_the_one_that_it_starts_from(tmp_path):
    start = "[[training]]\nname = 'c'\nmethod = 'a'\nstart = 'a'\n"
    content = read(tmp_path, start + ROWS)
    assert content.entries[0].after == ("a",)
    assert [entry.name for entry in content.in_running_order()] == ["b", "a", "c"]
    own = read(tmp_path, "[[training]]\nmethod = 'a'\nstart = 'a'\n")  # from shipped weights
    assert own.entries[0].after == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[queue]\nframse = 3\n" + ROWS, r"\[queue\]: no option 'framse'.*Did you mean 'frames'"),
        (ROWS + "crpo = 3", r"training 2 \(b\): no option 'crpo'.*Did you mean 'crop'"),
        (ROWS + "after = 'a'", "trainings wait for each other: a <- b <- a|b <- a <- b"),
        (ROWS + "after = 'x'", "'b': no training 'x' to come after; available: a, b"),
        (ROWS + "name = 'a'", "two trainings are named 'a'"),
        (ROWS + "after = 3", "name and after are names in quotes"),
        ("[queue]\nat_once = 0\n" + ROWS, "at_once = 0 is not a number of processes"),
        ("[[training]]\nframes = 3", "training 1: write its method"),
        ("[queue]\nframes = 3", "is no queue: write one table"),
        ("[quueue]\n" + ROWS, "is no queue: write one table"),
        ("frames", "the queue cannot be read: .* is not TOML"),
    ],
)
def test_a_mistake_in_the_file_is_named(tmp_path, text, message):
    with pytest.raises(QueueError, match=message):
        read(tmp_path, text)


def test_training_processes_have_the_lowest_priority():
    code = "import os; print(os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0))"
    output = subprocess.check_output(
        [sys.executable, "-c", code],
        start_new_session=True,
        preexec_fn=queue._use_spare_time,
        text=True,
    )
    assert output.split() in (["19", str(os.SCHED_IDLE)], ["19", str(os.SCHED_OTHER)])


@pytest.fixture(scope="module")
def words(tmp_path_factory) -> tuple[str, ...]:
    """Options of a training of one kernel on one small clip."""
    folder = tmp_path_factory.mktemp("words")
    clip, plugin = write_noise(folder / "noise", h=24, w=24), write_learner(folder)
    words = ("-m", "blur", "--plugin", str(plugin), "--clips", str(clip), "--device", "cpu")
    return (*words, "--crop", "16", "--eval-interval", "30")


def prepare(out: Path, name: str, words: tuple[str, ...], *more: str, after=()) -> Training:
    """A training in `out/name`."""
    words = (*words, "--out", str(out / name), *more)
    return Training(name, "blur", words, out / name / "blur", 60, tuple(after))


@pytest.fixture(scope="module")
def finished(tmp_path_factory, words) -> Iterator[tuple[list[str], list[RowStatus], Queue]]:
    """What a queue said and reached, and the queue: of five trainings, one fails, one waits."""
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
        patch.setattr(queue, "_use_spare_time", lambda: None)
        patch.setenv("RLBENCH_CACHE", str(out / "cache"))
        patch.setattr(queue, "POLL_S", 0.05)
        runner = Queue(trainings, out, 2, events.append)
        yield events, runner.run(), runner


def test_a_failed_training_stops_no_other_but_those_after_it(finished):
    _, status, _ = finished
    states = {row.training.name: row.state for row in status}
    assert states == {"third": "done", "fails": "failed", "waits": "waiting", "first": "done"}
    assert status[2].waits_for == ("fails",)


def test_a_failed_training_is_reported_with_its_last_line(finished):
    _, (_, failed, *_), _ = finished
    assert failed.message.startswith("exit code 2: error: 'blur' cannot use 1 of 1 clips")


def test_a_training_starts_when_the_one_before_it_is_done(finished):
    events, *_ = finished
    order = [line.partition(";")[0] for line in events]
    assert order.index("first: done") < order.index("third: started")


def test_a_training_starts_from_the_weights_of_another(finished):
    _, (third, *_), _ = finished
    origin = read_card(third.training.weights).origin
    assert re.fullmatch(r"blur after 60 frames, \w{12} \(2 of 2 tensors\)", origin)


def test_the_status_has_what_the_training_reached(finished):
    _, (third, *_), _ = finished
    assert (third.run.frames_seen, third.run.is_finished) == (60, True)
    assert third.run.speed > 0
    assert third.run.validation["clips"] == read_card(third.training.weights).curves["clips"][-1][1]


def test_a_second_call_skips_what_is_done_and_retries_what_failed(finished):
    events, _, runner = finished
    first_call = len(events)
    Queue(runner.trainings, runner.out, 1, events.append).run()
    started = [line.partition(":")[0] for line in events[first_call:] if ": started" in line]
    assert started == ["fails"]


def wait_until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not holds():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.05)


class Campaign:
    """A queue in a process of its own, with one training that never ends."""

    def __init__(self, out: Path, words: tuple[str, ...]) -> None:
        training = prepare(out, "blur", words, "--frames", str(10**6))
        self.out, self.trainings = out, [training]
        self.command = [sys.executable, "-c", RUN, str(out), str(training.folder), *training.words]

    def start(self) -> None:
        """Start, and wait until the training has begun or gone on."""
        before = self.frames()
        environment = os.environ | {"RLBENCH_CACHE": str(self.out / "cache")}
        self.process = subprocess.Popen(self.command, cwd=CHECKOUT, env=environment)
        wait_until(lambda: self.frames() > before or self.process.poll() is not None)

    def state(self) -> str:
        return read_status(self.trainings, self.out)[0].state

    def frames(self) -> int:
        return read_status(self.trainings, self.out)[0].run.frames_seen

    def log(self) -> list[dict[str, float]]:
        text = (self.trainings[0].folder / "log.jsonl").read_text()
        return [json.loads(line) for line in text.splitlines()]

    def processes(self) -> list[str]:
        """The command lines of the processes that train in the folder of this queue."""
        lines = [_read_words(process) for process in Path("/proc").glob("[0-9]*")]
        return [line for line in lines if "-m rlbench train" in line and str(self.out) in line]


def _read_words(process: Path) -> str:
    try:
        return (process / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:  # it has ended
        return ""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory, words) -> Iterator[Campaign]:
    running = Campaign(tmp_path_factory.mktemp("campaign"), words)
    running.start()
    yield running
    running.process.kill()
    running.process.wait()


def test_the_status_is_read_while_the_queue_runs(campaign):
    assert (campaign.state(), campaign.process.poll()) == ("running", None)
    before = campaign.frames()
    wait_until(lambda: campaign.frames() > before)


def test_one_queue_runs_in_a_folder(campaign):
    with pytest.raises(FolderInUseError, match="another rlbench"):
        Queue(campaign.trainings, campaign.out, 1).run()


def test_a_paused_queue_makes_no_progress_until_it_continues(campaign):
    queue.set_paused(campaign.out, True)
    before = campaign.frames()
    time.sleep(1.0)
    assert (campaign.state(), campaign.frames()) == ("paused", before)
    queue.set_paused(campaign.out, False)
    assert campaign.state() == "running"
    wait_until(lambda: campaign.frames() > before)


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_a_killed_queue_leaves_no_process_and_resumes(campaign, number):
    queue.set_paused(campaign.out, True)  # stopped processes end too
    campaign.process.send_signal(number)
    campaign.process.wait(TIMEOUT_S)
    wait_until(lambda: not campaign.processes())
    assert campaign.state() == "waiting"
    log = campaign.log()
    campaign.start()
    assert campaign.state() == "running"
    assert campaign.log()[: len(log) - 1] == log[:-1]  # the last line may be behind the checkpoint


def test_a_queue_that_does_not_run_cannot_be_paused(tmp_path):
    with pytest.raises(QueueError, match="no queue runs in"):
        queue.set_paused(tmp_path, True)
