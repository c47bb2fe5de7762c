"""Former names of options and commands work until the next release, and no help shows them."""

from __future__ import annotations

import re

import pytest

from rlbench.cli.app import COMMANDS, app
from rlbench.cli.old_spellings import CURRENT_OPTIONS, FORMER_MODES, RENAMED_OPTIONS, translate
from tests.cli.runner import rlbench
from tests.test_readme import click_commands

COMMANDS_WITH = {  # former option -> the commands that had it
    "--altered": ("train", "crossval"),
    "--budget": ("train", "crossval"),
    "--cap": ("render",),
    "--fresh": ("train",),
    "--half": ("run", "images", "train", "crossval"),
    "--norm": ("train", "crossval"),
    "--only": ("regress",),
    "--picture": ("lint",),
    "--retime": ("render",),
    "--views": ("render",),
}


@pytest.mark.parametrize("former", RENAMED_OPTIONS)
def test_a_former_option_is_translated_for_every_command_that_had_it(former):
    for command in COMMANDS_WITH[former]:
        translated, notes = translate([command, former, "1"])
        assert translated == [command, RENAMED_OPTIONS[former], "1"]
        assert notes == [
            f"note: '{former}' is now '{RENAMED_OPTIONS[former]}'; "
            "the former name works until the next release"
        ]
        options = {name for param in click_commands()[command].params for name in param.opts}
        assert RENAMED_OPTIONS[former] in options
        assert former not in options


@pytest.mark.parametrize("command", COMMANDS)
def test_no_help_shows_a_former_name(command):
    former = {*RENAMED_OPTIONS, *(option for _, option in FORMER_MODES)}
    former -= {option for name, option in CURRENT_OPTIONS if name == command}
    assert not former & set(re.findall(r"--[\w-]+", rlbench(command, "--help")))


def test_a_newer_command_keeps_an_option_with_a_former_name():
    assert translate(["stress", "ours", "--only", "budgets"]) == (
        ["stress", "ours", "--only", "budgets"],
        [],
    )


def test_a_former_option_with_an_equals_sign_is_translated():
    assert translate(["render", "--cap=64"])[0] == ["render", "--radiance-cap", "64"]
    assert translate(["render", "--scene=a=b.xml"])[0] == ["render-scene", "a=b.xml"]


@pytest.mark.parametrize(
    ("former", "today"),
    [
        ("train -m ours --range-test --frames 9", "lr-find -m ours --frames 9"),
        ("train --replay a.safetensors --device cpu", "replay a.safetensors --device cpu"),
        ("render --camera dolly --scene a.xml", "render-scene a.xml --camera dolly"),
        ("train --budget any", "train --train-spp default"),
    ],
)
def test_a_former_mode_is_a_command_of_its_own(former, today):
    translated, notes = translate(former.split())
    assert translated == today.split()
    assert notes


@pytest.mark.parametrize(
    "words", ["run -m half --out --bf16x", "render --scenes city", "lint a --scene b", "train -m a"]
)
def test_todays_names_are_unchanged(words):
    assert translate(words.split()) == (words.split(), [])


def test_a_command_with_a_former_option_runs_and_prints_a_note(clip_folder, tmp_path):
    words = ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    output = rlbench(*words, "--half")
    assert "note: '--half' is now '--bf16'" in output
    assert "1 cells measured" in output


def test_former_modes_reach_their_commands(tmp_path):
    output = rlbench("render", "--scene", tmp_path / "a.xml", "--frames", 2, code=2)
    assert "note: 'render --scene' is now 'render-scene'" in output
    assert "a.xml' does not exist" in output
    output = rlbench("train", "--replay", tmp_path / "b.safetensors", code=2)
    assert "b.safetensors' does not exist" in output
    assert "mean has nothing to train" in rlbench("train", "-m", "mean", "--range-test", code=2)


def test_the_former_name_of_an_import_format_works(tmp_path):
    words = ("import", tmp_path, "--out", tmp_path / "clips", "--format")
    assert "holds nothing of layout 'rl-path-tracing'" in rlbench(*words, "paper", code=2)
    assert "rl-path-tracing" in rlbench(*words, "rl-path-tracing", code=2)


def test_every_command_is_in_the_click_tree():
    assert set(click_commands()) == set(COMMANDS)
    assert app.registered_commands
