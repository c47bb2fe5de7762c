"""The command report, on results of small clips."""

from __future__ import annotations

import shutil

import pytest

from rlbench import registry
from rlbench.api import select_methods
from rlbench.benchmark import results as table
from rlbench.benchmark.listing import frames_trained
from rlbench.benchmark.results import UNFINISHED, Row
from rlbench.errors import OptionError
from rlbench.weights import read_card
from tests.cli.runner import rlbench
from tests.conftest import write_noise, write_plugin

NOT_PRETRAINED = ("ours", "ours/fast", "ours/fast@seed1")


def test_report_all_writes_what_it_can_and_says_why_it_skips_the_rest(run_mean, tmp_path):
    words = ("--results", tmp_path / "r", "--out", tmp_path / "figures")
    rlbench(*run_mean, "--spp", "1,2", "--repeats", 1, "--cost", "paper-2080ti")
    output = rlbench("report", "all", *words)
    assert f"{tmp_path}/figures/pareto.png" in output
    assert (tmp_path / "figures" / "summary.md").stat().st_size > 0
    reason = "no family has scores of its main variant and of another variant"
    assert f"report ablation is skipped: {reason}" in output
    assert "error: cannot write ablation: " in rlbench("report", "ablation", *words, code=2)


def test_a_report_of_images_needs_kept_images_and_shows_the_named_rows_in_order(
    image_results, image_run, tmp_path
):
    words = ("report", "zooms", "--results", image_results, "--clips", image_run / "clips")
    rlbench(*words, "-m", "mean,eaw", "--out", tmp_path / "figures")
    lines = (tmp_path / "figures" / "zooms.csv").read_text().splitlines()
    assert [line.split(",")[8] for line in lines[1:3]] == ["mean", "eaw"]
    assert "no images at 4 spp" in rlbench(*words, "--spp", "4", code=2)
    shutil.rmtree(image_results / "images")
    assert "the results keep no images" in rlbench(*words, code=2)


def test_an_unknown_report_names_the_nearest_one(plain_results):
    assert "Did you mean 'zooms'?" in rlbench("report", "zoom", "--results", plain_results, code=2)


def test_scenes_of_one_cost_profile_are_reported_together(tmp_path):
    for scene in ("city", "temple", "foyer"):
        write_noise(tmp_path / "clips" / scene, scene)
    words = ("--clips", tmp_path / "clips", "--out", tmp_path / "r", "--cost", "paper-2080ti")
    rlbench("run", "-m", "mean", "--spp", "1,2", "--repeats", 1, *words)
    for report in ("summary", "pareto"):
        rlbench("report", report, "--results", tmp_path / "r", "--out", tmp_path / "figures")


def test_table1_says_how_long_shipped_weights_were_trained(tmp_path):
    write_noise(tmp_path / "clips" / "city", "city")
    words = (
        "-m",
        "mean,oidn/tuned",
        "--spp",
        "1",
        "--clips",
        tmp_path / "clips",
        "--times",
        "none",
    )
    trained = {}
    for weights in ((), ("--weights", "random")):
        rlbench("run", *words, *weights, "--out", tmp_path / "r")
        trained |= frames_trained(table.read(tmp_path / "r"))
    frames = read_card(registry.shipped_weights("oidn/tuned")).frames_trained
    assert trained == {"oidn/tuned": frames}
    rlbench("report", "table1", "--results", tmp_path / "r", "--out", tmp_path)
    assert f" | {frames:,} | " in (tmp_path / "table1.md").read_text()


def test_report_all_skips_what_needs_times_after_scores_alone(plain_results, tmp_path):
    words = ("--results", plain_results, "--out", tmp_path / "figures")
    output = rlbench("report", "all", *words)
    assert "report pareto is skipped: no method has all of psnr, plan_ms" in output
    rlbench("report", "pareto", *words, code=2)
    assert (tmp_path / "figures" / "summary.md").stat().st_size > 0


def test_scores_of_an_evaluation_that_did_not_finish_are_reported_with_a_note(
    plain_results, tmp_path
):
    copy = shutil.copytree(plain_results, tmp_path / "evaluated")
    (copy / UNFINISHED).touch()
    output = rlbench("report", "summary", "--results", copy)
    assert "rlbench evaluate did not finish" in output


def test_a_method_without_rows_is_an_error_of_report(plain_results):
    words = ("report", "summary", "--results", plain_results)
    for missing in ("svgf", "mean@sede1"):
        output = rlbench(*words, "-m", f"mean,{missing}", code=2)
        assert f"has no rows of {missing}; available: eaw, mean" in output
    assert not (plain_results / "report").exists()
    rlbench(*words, "-m", "all,mean")  # a pattern selects the rows that exist
    assert (plain_results / "report" / "summary.md").is_file()  # beside its table


def test_rows_of_a_plugin_can_be_reported_without_it(clip_folder, tmp_path):
    plugin, out = write_plugin(tmp_path / "grey.py", "grey"), tmp_path / "r"
    words = ("--clips", clip_folder, "--spp", 1, "--times", "none", "--out", out)
    rlbench("run", "-m", "grey,mean", "--plugin", plugin, *words)
    registry.clear_plugins()
    words = ("report", "summary", "--results", out, "--out", tmp_path / "figures")
    rlbench(*words, "-m", "grey")
    assert "| grey |" in (tmp_path / "figures" / "summary.md").read_text()
    output = rlbench(*words, "-m", "imcd", code=2)
    assert output.endswith("has no rows of imcd; available: grey, mean")


def test_a_report_without_results_is_an_error(tmp_path):
    assert "error: no results in" in rlbench("report", "--results", tmp_path, code=2)


def test_results_one_level_down_are_named(plain_results):
    output = rlbench("report", "summary", "--results", plain_results.parent, code=2)
    assert f"did you mean {plain_results}?" in output


def test_a_pattern_selects_rows_of_variants_without_shipped_weights(tmp_path):
    rows = table.to_dataframe(
        [Row("r", name, "a", "a", 1, 1, 0, "psnr", 20.0) for name in NOT_PRETRAINED]
    )
    selected = select_methods(rows, ["ours/*"], tmp_path)
    assert set(selected["method"]) == set(NOT_PRETRAINED)
    with pytest.raises(OptionError, match="has no rows of svgf/"):
        select_methods(rows, ["svgf/*"], tmp_path)


def test_a_report_is_compared_with_the_results_of_another_preset(plain_results, tmp_path):
    words = ("report", "real", "--results", plain_results, "--out", tmp_path / "figures")
    assert "name results to compare with by --against" in rlbench(*words, code=2)
    rlbench(*words, "--against", plain_results)
    assert "| psnr, " in (tmp_path / "figures" / "real.md").read_text()
    assert "another folder has preset" in rlbench(
        *words, "--against", f"{plain_results},{plain_results}", code=2
    )
    words = ("report", "summary", "--results", plain_results, "--against", plain_results)
    assert "report 'summary' compares no presets" in rlbench(*words, code=2)
