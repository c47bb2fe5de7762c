"""The command decide, on results of small clips."""

from __future__ import annotations

import json

import pytest

from tests.cli.runner import rlbench
from tests.conftest import write_noise

COSTS = ("--sample-ms", 4.2, "--frame-ms", 60_000)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("decide")
    for scene in ("city", "temple"):
        write_noise(root / "clips" / scene, scene)
    words = ("--clips", root / "clips", "--out", root / "r", "--spp", "1,2")
    rlbench("run", "-m", "mean,svgf", "--cost", "paper-2080ti", *words)
    return root / "r"


def test_the_answer_names_method_budget_size_and_break_evens(folder):
    output = rlbench("decide", *COSTS, "--results", folder)
    for text in (" spp: PSNR ", "Runner-up: ", "What would change the answer", "was measured on"):
        assert text in output
    assert "do not state" not in output  # the rows have the size of the image


def test_json_has_the_same_answer(folder):
    text = rlbench("decide", *COSTS, "--results", folder)
    decision = json.loads(rlbench("decide", *COSTS, "--results", folder, "--json"))
    assert text.startswith(decision["candidates"][0]["method"])
    assert {c["method"] for c in decision["candidates"]} == {"mean", "svgf"}
    assert decision["image_sizes"]


def test_methods_that_need_other_channels_are_left_out_and_named(folder):
    output = rlbench("decide", *COSTS, "--results", folder, "--needs", "albedo,normal")
    assert output.startswith("mean at ")
    assert "svgf is left out: it needs depth, motion" in output


def test_an_unknown_channel_is_refused_with_those_that_there_are(folder):
    output = rlbench("decide", *COSTS, "--results", folder, "--needs", "albdo", code=2)
    assert "--needs albdo: no such G-buffer channel. Did you mean 'albedo'?" in output


def test_scenes_select_and_an_unknown_one_is_refused(folder):
    words = ("decide", *COSTS, "--results", folder, "--json", "--scenes")
    assert json.loads(rlbench(*words, "city"))["scenes"] == ["city"]
    assert "has no rows of it; available: city, temple" in rlbench(*words, "cty", code=2)


def test_a_deadline_that_nothing_meets_is_an_error_that_names_the_cheapest(folder):
    words = ("decide", "--sample-ms", 4.2, "--frame-ms", 1, "--results", folder)
    assert "error: no method fits 1 ms at 4.2 ms a sample; the cheapest, " in rlbench(
        *words, code=2
    )


def test_a_cost_that_is_no_number_above_zero_is_refused(folder):
    words = ("decide", "--frame-ms", 10, "--results", folder, "--sample-ms")
    for text in ("0", "-1", "nan", "x"):
        assert "is no number above 0" in rlbench(*words, text, code=2)
