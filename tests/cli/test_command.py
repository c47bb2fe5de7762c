"""What all commands share: names with and without -m, verbosity, Ctrl-C, pipes, full disks."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from rlbench.benchmark import results as table
from rlbench.cli.app import app
from rlbench.cli.command import SHORT_HELP, what_is_kept
from rlbench.cli.commands import list_commands
from rlbench.cli.run import FIRST_RUN
from rlbench.system.folder_lock import LOCK_FILE, locked_folder
from tests.cli.runner import ENVIRONMENT, rlbench
from tests.conftest import write_plugin
from tests.test_readme import click_commands

RLBENCH = [sys.executable, "-m", "rlbench"]


def commands_with_methods() -> list[str]:
    """The commands whose bare words are methods."""
    return [name for name, each in click_commands().items() if each.takes_bare_methods]


def test_bare_words_are_methods_where_a_command_has_no_argument():
    expected = {"check", "compare", "crossval", "decide"}
    expected |= {"regress", "run", "speed", "stress", "train"}
    expected |= {"images"} & click_commands().keys()  # of an app
    assert set(commands_with_methods()) == expected


@pytest.mark.parametrize("command", commands_with_methods())
def test_methods_may_stand_alone_and_the_help_shows_one_form(command):
    parser = click_commands()[command].make_context
    for words in (["ours,ntas", "mean"], ["-m", "ours,ntas", "-m", "mean"], ["ours,ntas", "-m=x"]):
        context = parser(command, words, resilient_parsing=True)
        assert len(context.params["methods"]) == 2
    text = CliRunner().invoke(app, [command, "--help"]).output
    assert f"Usage: root {command} [OPTIONS]\n" in text
    assert "-m, --methods" in text


@pytest.mark.parametrize("command", list_commands())
def test_the_help_shows_the_first_options_and_help_all_every_one(command):
    parameters = click_commands()[command].params
    options = [max(p.opts, key=len) for p in parameters if p.param_type_name == "option"]
    short, full = (rlbench(command, word) for word in ("-h", "--help-all"))
    assert all(name in short for name in options[:SHORT_HELP])
    assert all(name in full for name in options)


def test_a_run_without_methods_measures_the_rows_of_the_demo_and_says_so(clip_folder, tmp_path):
    rows = (*FIRST_RUN, "mine")
    words = ("run", "--clips", clip_folder, "--spp", 1, "--times", "none", "--limit-frames", 1)
    plugin = write_plugin(tmp_path / "mine.py", "mine")
    output = rlbench(*words, "--plugin", plugin, "--out", tmp_path / "r")
    note = f"rows of a first run: {', '.join(rows)}; -m all runs one row of every method"
    assert output.startswith(note)
    assert set(table.read(tmp_path / "r")["method"]) == set(rows)


def test_quiet_prints_results_alone_and_verbose_each_step(run_mean):
    words = (*run_mean, "--spp", 1, "--half", "--times", "none")
    note, step = "--half and --weights have no effect", "rlbench.benchmark.runner: mean on noise"
    quiet = rlbench(*words, "-q")
    assert "passed" in quiet
    assert note not in quiet
    assert step not in quiet
    verbose = rlbench("--verbose", *words)
    assert note in verbose
    assert re.search(rf"\d\d:\d\d:\d\d\.\d+ {step} at 1 spp, seed 0: in the results", verbose)


@pytest.mark.usefixtures("interrupts")
def test_ctrl_c_says_what_is_kept_and_the_same_command_continues(clip_folder, tmp_path):
    body = (
        "import signal, pathlib; file = pathlib.Path(__file__).with_name('interrupted'); "
        "file.exists() or (file.touch(), signal.raise_signal(signal.SIGINT)); "
        "return samples.mean, None"
    )
    plugin = write_plugin(tmp_path / "slow.py", "slow", body=body)
    words = ("run", "mean,slow", "--plugin", plugin, "--clips", clip_folder, "--spp", 1)
    words = (*words, "--times", "none", "--out", tmp_path / "r")
    output = rlbench(*words, code=130)
    kept = f"interrupted: finished cells are kept in {tmp_path}/r. The same command continues"
    assert kept in output
    assert "1 cells measured, 1 already in the results" in rlbench(*words)


def test_the_commands_that_continue_say_what_they_keep():
    keeping = {name for name, entry in list_commands().items() if entry.kept}
    assert keeping >= {"run", "render", "train", "stress", "crossval", "evaluate"}
    assert "kept in a/evaluated" in what_is_kept("evaluate", {"results": "a", "out": None})
    assert what_is_kept("decide", {}) == "interrupted: nothing was kept"


@pytest.mark.app("view")
def test_an_interrupted_command_that_begins_again_says_so():
    assert "videos are kept. The same command begins again" in what_is_kept("video", {})


@pytest.mark.parametrize("words", [["list", "--json"], ["cache"]])
def test_a_reader_that_goes_away_ends_a_command_quietly(tmp_path, words):
    reader, writer = os.pipe()
    os.close(reader)
    command, env = [*RLBENCH, *words], {**ENVIRONMENT, "RLBENCH_CACHE": str(tmp_path)}
    process = subprocess.run(
        command, stdout=writer, stderr=subprocess.PIPE, text=True, env=env, check=False
    )
    os.close(writer)
    assert (process.stderr, process.returncode) == ("", 141)


def test_a_second_run_into_the_same_folder_is_refused(run_mean, tmp_path):
    with locked_folder(tmp_path / "r"):
        output = rlbench(*run_mean, code=2)
    assert f"another rlbench (process {os.getpid()} on " in output
    assert f"writes to {tmp_path}/r. Wait until it ends and repeat the command" in output
    rlbench(*run_mean, "--spp", 1, "--times", "none")
    assert not (tmp_path / "r" / LOCK_FILE).exists()


def test_a_disk_that_fills_up_stops_a_run_and_keeps_what_it_wrote(run_mean, small_disk):
    words = (*run_mean[:-1], small_disk / "r", "--spp", "1,2,3,4,5,6,7,8", "--times", "none")
    output = rlbench(*words, code=2)
    assert re.search(r"error: \S+.* cannot be written .* has \d+ bytes free", output)
    assert output.endswith("--out names another folder")
    assert 0 < len(table.cells(small_disk / "r")) < 8


def test_a_full_disk_is_found_before_the_run(run_mean, small_disk, monkeypatch):
    (small_disk / "rest").write_bytes(bytes(os.statvfs(small_disk).f_bavail * 4096))
    output = rlbench(*run_mean[:-1], small_disk / "r", code=2)
    assert f"No space left on device; {small_disk} has 0 bytes free" in output
    assert output.endswith("name another folder by --out")
    monkeypatch.setenv("RLBENCH_CACHE", str(small_disk / "c"))
    output = rlbench("render", code=2)
    assert output.endswith("name another folder by the variable RLBENCH_CACHE")


OUT = [  # commands that write, up to the option for the folder
    ("run", "mean", "--clips", "CLIP"),
    pytest.param(("images", "mean", "--clips", "CLIP"), marks=pytest.mark.app("view")),
    ("speed", "mean"),
    ("stress", "mean"),
    ("train", "oidn/tuned"),
    ("crossval", "mean"),
    ("new", "fresh"),
]


@pytest.mark.parametrize("words", OUT, ids=lambda words: words[0])
def test_an_output_folder_below_a_file_is_found_at_once(words, clip_folder, tmp_path):
    (tmp_path / "file").touch()
    words = [clip_folder if word == "CLIP" else word for word in words]
    output = rlbench(*words, "--out", tmp_path / "file" / "r", code=2)
    assert f"error: nothing can be written to {tmp_path}/file" in output
    assert not (tmp_path / "cache").exists()
