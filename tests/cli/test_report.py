"""The commands report and evaluate, on results of small clips."""

from __future__ import annotations

import shutil

from rlbench import registry
from rlbench.api import select_methods
from rlbench.benchmark import results as table
from rlbench.benchmark.listing import frames_trained
from rlbench.benchmark.results import UNFINISHED, Row
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
    shutil.rmtree(image_results / "images")
    assert "the results keep no images" in rlbench(*words, code=2)


def test_table1_says_how_long_shipped_weights_were_trained(tmp_path):
    write_noise(tmp_path / "clips" / "city", "city")
    words = ("run", "-m", "mean,oidn/tuned", "--spp", 1, "--times", "none", "--out", tmp_path / "r")
    trained = {}
    for weights in ((), ("--weights", "random")):
        rlbench(*words, "--clips", tmp_path / "clips", *weights)
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
    (plain_results / UNFINISHED).touch()
    output = rlbench("report", "summary", "--results", plain_results)
    assert "rlbench evaluate did not finish" in output


def test_a_pattern_selects_the_rows_that_exist_and_the_pages_lie_beside_their_table(plain_results):
    rlbench("report", "summary", "--results", plain_results, "-m", "all,mean")
    assert (plain_results / "report" / "summary.md").is_file()


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


def test_a_pattern_selects_rows_of_variants_without_shipped_weights(tmp_path):
    rows = table.to_dataframe(
        [Row("r", name, "a", "a", 1, 1, 0, "psnr", 20.0) for name in NOT_PRETRAINED]
    )
    selected = select_methods(rows, ["ours/*"], tmp_path)
    assert set(selected["method"]) == set(NOT_PRETRAINED)


def test_a_report_is_compared_with_the_results_of_another_preset(plain_results, tmp_path):
    words = ("report", "real", "--results", plain_results, "--out", tmp_path / "figures")
    rlbench(*words, "--against", plain_results)
    assert "| psnr, " in (tmp_path / "figures" / "real.md").read_text()


def test_images_are_scored_under_conventions_and_reported(image_results, image_run, tmp_path):
    clips = ("--clips", image_run / "clips")
    words = ("evaluate", image_results, "--metrics", "psnr,relmse", *clips)
    words = (*words, "--convention", "srgb,hable")
    assert "psnr, psnr@hable, relmse: 12 scored, 0 already in the results" in rlbench(*words)
    assert "0 scored, 12 already" in rlbench(*words)
    scores = image_results / "evaluated"
    assert set(table.read(scores)["metric"]) == {"psnr", "psnr@hable", "relmse"}
    rlbench("report", "summary", "--results", scores, "--out", tmp_path / "report")
    assert "### psnr@hable [dB]" in (tmp_path / "report" / "summary.md").read_text()


def test_a_metric_that_fails_is_named_and_the_exit_code_is_1(image_results, image_run, monkeypatch):
    monkeypatch.setattr("metrics.image.relmse", lambda *images: 1 / 0)
    words = ("evaluate", image_results, "--metrics", "relmse", "-m", "mean")
    output = rlbench(*words, "--clips", image_run / "clips", code=1)
    assert "failed: mean on noise at 1 spp, seed 0, relmse: ZeroDivisionError" in output
