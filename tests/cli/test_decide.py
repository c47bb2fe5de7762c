"""The commands decide and compare, on results of small clips."""

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
    rlbench("run", "-m", "mean,svgf", "--draws", 2, "--cost", "paper-2080ti", *words)
    return root / "r"


def test_text_and_json_have_the_same_answer(folder):
    text = rlbench("decide", *COSTS, "--results", folder)
    words = ("decide", *COSTS, "--results", folder, "--json", "--scenes", "city")
    decision = json.loads(rlbench(*words))
    assert decision["scenes"] == ["city"]
    assert f"{decision['candidates'][0]['method']} at " in text
    assert "do not state" not in text  # the rows have the size of the image
    assert {c["method"] for c in decision["candidates"]} == {"svgf"}
    assert decision["image_sizes"] == ["24x20"]


def test_methods_that_need_other_channels_are_left_out_and_named(folder):
    output = rlbench("decide", *COSTS, "--results", folder, "--needs", "albedo,normal")
    assert ". mean at " in output
    assert "svgf is left out: it needs depth, motion" in output


def test_a_cost_profile_gives_the_times_and_the_cost_of_a_sample(folder, tmp_path):
    write_profile(tmp_path / "gpu.toml", "GPU", (1080, 1920), 4.0, {"1920x1080": {"svgf": 2.0}})
    words = ("decide", "--frame-ms", 30, "--results", folder, "--json")
    decision = json.loads(rlbench(*words, "--cost", tmp_path / "gpu.toml", "--gbuffer-ms", 3))
    (best,) = decision["candidates"]
    assert (best["gbuffer_ms"], best["inference_ms"]) == pytest.approx((3.0, 2.0))
    assert best["sampling_ms"] == pytest.approx(4.0 * best["spp"])
    assert (decision["sample_ms"], decision["image_sizes"]) == (4.0, ["1920x1080"])


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


def test_a_comparison_has_a_verdict_for_each_budget_and_is_of_the_selected_rows(folder):
    words = ("compare", "mean", "svgf", "--results", folder)
    output = rlbench(*words)
    assert output.startswith("mean against svgf: PSNR")
    assert "2 scenes, 2 clips, 2 orders of samples" in output
    assert "1 spp: mean " in output
    comparison = json.loads(rlbench(*words, "--json", "--spp", "2", "--scenes", "city"))
    assert [budget["target_spp"] for budget in comparison["budgets"]] == [2.0]
    assert (comparison["scenes"], comparison["seeds"]) == (["city"], [0, 1])
