"""The command decide, on results of small clips."""

from __future__ import annotations

import json

import pytest

import rlbench as rlbench_package
from rlbench.benchmark.cost_profile import write_profile
from tests.cli.runner import rlbench
from tests.conftest import write_noise

COSTS = ("--sample-ms", 4.2, "--frame-ms", 60_000)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("decide")
    for scene in ("city", "temple"):
        write_noise(root / "clips" / scene, scene)
    words = ("--clips", root / "clips", "--out", root / "r", "--spp", "1,2", "--repeats", 1)
    rlbench("run", "-m", "mean,svgf", "--cost", "paper-2080ti", *words)
    return root / "r"


def test_the_answer_names_method_budget_size_and_break_evens(folder):
    output = rlbench("decide", *COSTS, "--results", folder)
    for text in (
        " spp: PSNR ",
        "Without a denoiser, mean",
        "What would change the answer",
        "was measured on",
    ):
        assert text in output
    assert "do not state" not in output  # the rows have the size of the image


def test_json_has_the_same_answer(folder):
    text = rlbench("decide", *COSTS, "--results", folder)
    decision = json.loads(rlbench("decide", *COSTS, "--results", folder, "--json"))
    assert f" {decision['candidates'][0]['method']} at " in text
    assert {c["method"] for c in decision["candidates"]} == {"svgf"}
    assert decision["image_sizes"]


def test_methods_that_need_other_channels_are_left_out_and_named(folder):
    output = rlbench("decide", *COSTS, "--results", folder, "--needs", "albedo,normal")
    assert ". mean at " in output
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
    assert "error: no denoiser with a time fits 1 ms at 4.2 ms a sample; " in rlbench(
        *words, code=2
    )


def test_a_cost_that_is_no_number_above_zero_is_refused(folder):
    words = ("decide", "--frame-ms", 10, "--results", folder, "--sample-ms")
    for text in ("0", "-1", "nan", "x"):
        assert "is not a number above 0" in rlbench(*words, text, code=2)


def test_a_cost_profile_gives_the_times_and_the_cost_of_a_sample(folder, tmp_path):
    write_profile(tmp_path / "gpu.toml", "GPU", (1080, 1920), 4.0, {"1920x1080": {"svgf": 2.0}})
    words = ("decide", "--frame-ms", 30, "--results", folder, "--json")
    decision = json.loads(rlbench(*words, "--cost", tmp_path / "gpu.toml", "--gbuffer-ms", 3))
    (best,) = decision["candidates"]
    assert (best["gbuffer_ms"], best["inference_ms"]) == pytest.approx((3.0, 2.0))
    assert best["sampling_ms"] == pytest.approx(4.0 * best["spp"])
    assert (decision["sample_ms"], decision["image_sizes"]) == (4.0, ["1920x1080"])
    assert "--sample-ms or --cost" in rlbench(*words[:-1], code=2)


def test_a_cost_of_samples_alone_keeps_the_times_of_the_results(folder, tmp_path):
    (tmp_path / "mine.toml").write_text("default_ms = 4.2\n")
    words = ("decide", "--frame-ms", 30, "--results", folder, "--json")
    by_file = json.loads(rlbench(*words, "--cost", tmp_path / "mine.toml"))
    assert by_file == json.loads(rlbench(*words, "--sample-ms", 4.2))


def test_results_are_an_option_or_a_word_and_python_answers_alike(folder):
    by_option = rlbench("decide", *COSTS, "--results", folder, "--json")
    assert rlbench("decide", folder, *COSTS, "--json") == by_option
    decision = rlbench_package.decide(60_000, 4.2, folder=folder)
    assert decision.candidates[0].method == json.loads(by_option)["candidates"][0]["method"]
    gap = rlbench_package.compare("svgf", "mean", folder=folder)
    assert "svgf against mean" in rlbench("compare", "svgf,mean", folder)
    assert (gap.first, gap.second) == ("svgf", "mean")
