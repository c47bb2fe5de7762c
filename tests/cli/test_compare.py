"""The command compare, on results of small clips."""

from __future__ import annotations

import json

import pytest

from tests.cli.runner import rlbench
from tests.conftest import write_noise


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("compare")
    for scene in ("city", "temple"):
        write_noise(root / "clips" / scene, scene)
    words = (
        "--clips",
        root / "clips",
        "--out",
        root / "r",
        "--spp",
        "1,2",
        "--draws",
        2,
        "--times",
        "none",
    )
    rlbench("run", "-m", "mean,svgf", *words)
    return root / "r"


def test_the_answer_has_a_verdict_for_each_budget(folder):
    output = rlbench("compare", "mean", "svgf", "--results", folder)
    assert output.startswith("mean against svgf: PSNR")
    assert "2 scenes, 2 clips, 2 orders of samples" in output
    assert "1 spp: mean " in output
    assert "2 spp: mean " in output


def test_budgets_and_scenes_select(folder):
    words = ("compare", "mean", "svgf", "--results", folder, "--json")
    comparison = json.loads(rlbench(*words, "--spp", "2", "--scenes", "city"))
    assert [budget["target_spp"] for budget in comparison["budgets"]] == [2.0]
    assert (comparison["scenes"], comparison["seeds"]) == (["city"], [0, 1])


def test_what_the_results_do_not_have_is_refused_with_what_there_is(folder):
    words = ("compare", "mean", "svgf", "--results", folder)
    assert "has no rows of it; available: 1, 2" in rlbench(*words, "--spp", "3", code=2)
    assert "available: city, temple" in rlbench(*words, "--scenes", "cty", code=2)
    assert "metrics that do: " in rlbench(*words, "--metric", "psrn", code=2)
    assert "name two different rows" in rlbench("compare", "mean", "mean", *words[3:], code=2)


def test_draws_are_seeds_from_zero_and_exclude_seed(folder):
    words = ("run", "-m", "mean", "--draws", 3, "--seed", "5", "--out", folder)
    assert "--draws 3 is --seed 0:3, and --seed was given too" in rlbench(*words, code=2)
