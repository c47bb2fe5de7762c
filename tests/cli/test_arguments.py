"""Parsers of option values: what they accept, and what they say about the rest."""

from __future__ import annotations

import inspect
from dataclasses import fields
from pathlib import Path

import pytest
import typer

from rlbench.benchmark.run_options import RunOptions
from rlbench.cli import arguments
from rlbench.cli.arguments import WeightsChoice
from rlbench.cli.crossval import crossval
from rlbench.cli.methods import expand_methods
from rlbench.cli.options import SHIPPED
from rlbench.cli.run import run
from rlbench.cli.train import train
from rlbench.cli.verbosity import set_verbosity
from rlbench.training import TrainingConfig
from tests.conftest import install_plugin


@pytest.mark.parametrize(
    ("command", "record", "lacks"),
    [  # what a command fills in itself, or leaves as it is
        (run, RunOptions, "executor on_cell seeds weights_for weights_label"),
        (train, TrainingConfig, "ema_decay spp"),
        (
            crossval,
            TrainingConfig,
            "anchor anneal ema_decay eval_interval keep mix most_frames sequence_length until_flat",
        ),
    ],
)
def test_a_command_has_the_options_of_its_record_and_their_defaults(command, record, lacks):
    options = inspect.signature(command).parameters
    assert {each.name for each in fields(record)} - options.keys() == set(lacks.split())
    known = {each.name: each.default for each in fields(record)}
    defaults = {name: each.default for name, each in options.items() if name in known}
    unset = (None, SHIPPED)  # what the command replaces
    others = {name for name, value in defaults.items() if value not in (*unset, known[name])}
    assert others == ({"spp"} if command is crossval else set())  # its --spp is that of the scores


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [
        (arguments.parse_budgets, "0.5,1,2", (0.5, 1, 2)),
        (arguments.parse_budgets, " 1 , 4, 1.0 ", (1, 4)),
        (arguments.parse_train_spp, "default", ()),  # of the method
        (arguments.parse_train_spp, "0.5,4", (0.5, 4)),
        (arguments.parse_seeds, "0:3", (0, 1, 2)),
        (arguments.parse_seeds, "3,1,3", (3, 1)),
        (arguments.parse_seeds, "0:2,9,1:3", (0, 1, 9, 2)),
        (arguments.parse_seeds, (3,), (3,)),
        (arguments.parse_size, "320x192", (192, 320)),  # height, width
        (arguments.parse_positive, "0.5", 0.5),
        (arguments.parse_positive, 1.5, 1.5),
        (arguments.parse_definition, "a=b=c", ("a", "b=c")),
        (arguments.parse_definition, "a=", ("a", "")),
    ],
)
def test_a_value_is_parsed(parse, text, value):
    assert parse(text) == value


REFUSED = {
    arguments.parse_budgets: (
        ("one", "-1", "nan", "1,inf", "", ","),
        "is not a list of budgets. Give samples per pixel",
    ),
    arguments.parse_seeds: (
        ("48:0", "a", "", "-1", "1:", ":3", "1:2:3", "1.5"),
        "a range such as 0:48, which excludes its end",
    ),
    arguments.parse_size: (
        ("320", "0x10", "10x0", "axb", "10x10x10", "-1x2"),
        "is not a size. Give WIDTHxHEIGHT",
    ),
    arguments.parse_positive: (("0", "-1", "nan", "inf", "much"), "not a number above 0"),
    arguments.parse_definition: (("a", "=b"), "is no NAME=VALUE"),
}


@pytest.mark.parametrize(
    ("parse", "text", "message"),
    [(parse, text, why) for parse, (texts, why) in REFUSED.items() for text in texts],
)
def test_other_values_are_refused(parse, text, message):
    with pytest.raises(typer.BadParameter, match=message):
        parse(text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("random", WeightsChoice("random")),
        ("a.safetensors", WeightsChoice("a.safetensors")),
        ("b=c.safetensors", WeightsChoice("b=c.safetensors")),  # a file with = in its name
        ("seed1=a.safetensors", WeightsChoice("a.safetensors", "seed1")),
        (
            "reinforce+surrogate=a.safetensors",
            WeightsChoice("a.safetensors", "reinforce+surrogate"),
        ),
    ],
)
def test_weights_may_be_named(text, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.safetensors").touch()
    Path("b=c.safetensors").touch()
    assert arguments.parse_weights(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed1=b.safetensors", "'b.safetensors' does not exist. .*'rlbench train' writes one"),
        ("b.safetensors", "'b.safetensors' does not exist"),
        ("a@b=file", "Use letters, digits"),
        ("half=file", "METHOD@half names rows of another kind"),
        ("crossval=file", "METHOD@crossval names rows of another kind"),
    ],
)
def test_weights_without_a_file_or_a_possible_name_are_refused(text, message):
    with pytest.raises(typer.BadParameter, match=message):
        arguments.parse_weights(text)


def test_all_skips_a_broken_family_and_says_so(tmp_path, monkeypatch, capsys):
    install_plugin(tmp_path, monkeypatch, "methods", "torn = nowhere_at_all:FAMILY")
    set_verbosity(verbose=False, quiet=False)  # as the program does before each command
    names = expand_methods(["all"])
    assert "mean" in names
    assert "torn" not in names
    assert "'all' skips torn, which cannot be imported: ModuleNotFound" in capsys.readouterr().err
    with pytest.raises(ModuleNotFoundError):
        expand_methods(["mean,torn"])
