"""The commands run, report and regress, on small clips."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.benchmark import results as table
from rlbench.benchmark.results import Row
from rlbench.cli import benchmark
from rlbench.errors import OptionError
from tests.cli.runner import CHECKOUT, ENVIRONMENT, python, rlbench
from tests.conftest import write_noise, write_plugin

NOT_PRETRAINED = ("ours", "ours/encoder-small", "ours/encoder-large@seed1")


@pytest.fixture
def run_mean(clip_folder, tmp_path):
    """The command that runs `mean` on one small clip."""
    return ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")


def scores(results: Path) -> list[tuple]:
    rows = table.read(results)
    kept = rows[~rows["metric"].str.endswith("_ms")]
    return sorted(kept.itertuples(index=False, name=None), key=repr)


def test_run_prints_scores_and_where_the_results_are(run_mean, tmp_path):
    output = rlbench(*run_mean)
    message = "4 cells measured, 0 already in the results, 0 skipped; results are in"
    assert f"{message} {tmp_path}/r" in output
    assert "PSNR" in output


def test_scores_of_another_device_are_not_averaged_in(run_mean, tmp_path):
    words = (*run_mean, "--spp", 1)
    rlbench(*words)
    own = table.read(tmp_path / "r")
    (cell,) = table.cells(tmp_path / "r")
    others = [Row(**row) for row in own.assign(device="abacus").to_dict("records")]
    others = [replace(row, value=0.0 if row.value == row.value else row.value) for row in others]
    other_cell = replace(cell, key=replace(cell.key, device="abacus"))
    table.write_cell(tmp_path / "r", other_cell, others)
    assert set(table.read(tmp_path / "r")["device"]) == {"abacus", *own["device"]}
    psnr = own[own["metric"] == "psnr"]["value"].mean()
    assert f"│ mean │ 1 │ {psnr:.2f} │" in rlbench(*words)


def test_the_same_run_again_does_nothing_and_says_so(run_mean):
    rlbench(*run_mean)
    assert "nothing to do: all 4 cells are in" in rlbench(*run_mean)


def test_clips_of_a_folder_are_selected_by_scene(tmp_path):
    for scene in ("foyer", "attic"):
        write_noise(tmp_path / "clips" / scene, scene)
    words = ("run", "-m", "mean", "--clips", tmp_path / "clips", "--out", tmp_path / "r")
    rlbench(*words, "--scenes", "attic", "--spp", "1,2")
    assert set(table.read(tmp_path / "r")["scene"]) == {"attic"}


def test_clips_of_a_scene_are_selected_together_or_one_by_one(tmp_path):
    for name in ("attic", "attic-cut", "foyer"):
        write_noise(tmp_path / "clips" / name, name.partition("-")[0])
    words = ("run", "-m", "mean", "--clips", tmp_path / "clips", "--spp", 1)
    rlbench(*words, "--out", tmp_path / "both", "--scenes", "attic")
    rlbench(*words, "--out", tmp_path / "one", "--scenes", "attic-cut")
    assert set(table.read(tmp_path / "both")["clip"]) == {"attic", "attic-cut"}
    assert set(table.read(tmp_path / "one")["clip"]) == {"attic-cut"}


def test_only_the_first_frames_are_run_on_request(run_mean, tmp_path):
    words = (*run_mean, "--spp", 1)
    rlbench(*words, "--limit-frames", 2)
    assert set(table.read(tmp_path / "r")["frame"]) == {-1, 0, 1}
    output = rlbench(*words, "--limit-frames", 1)
    assert "1 cells measured, 0 already in the results, 0 skipped, 1 older ones replaced" in output


def test_seeds_may_be_a_range(run_mean, tmp_path):
    rlbench(*run_mean, "--spp", 1, "--seed", "0:2")
    assert set(table.read(tmp_path / "r")["seed"]) == {0, 1}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--methods", "foo"), "error: 'foo' is not a method; there are: dasr, eaw, imcd, mean"),
        (("--methods", "mean/A9"), "error: 'mean' has no variant 'A9'; it has: mean"),
        (("--spp", "one"), "Error: Invalid value for '--spp': 'one' is no list of budgets"),
        (("--spp", "-1"), "Error: Invalid value for '--spp': '-1' is no list of budgets"),
        (("--seed", "x"), "Error: Invalid value for '--seed': 'x' is no list of seeds"),
        (("--cost", "mine"), "error: no cost profile 'mine'. Use measured, paper-2080ti"),
        (("--device", "abacus"), "error: device abacus cannot be used on this machine"),
        (("--scenes", "cellar"), "error: the clips show no scene cellar; available: noise"),
        (("--scenes", "noise,celar"), "error: the clips show no scene celar; available: noise"),
        (("--plugin", "nowhere.py"), "error: no plugin file at"),
        (("--takes", "main"), "error: --takes applies to preset scenes only. With --clips"),
        (("--takes", "some"), "'some' is not one of 'main', 'all'"),
        (("--pool", "dead"), "'dead' is not one of 'stored', 'live'"),
        (("--engine", "steam"), "'steam' is not one of 'local', 'ray'"),
        (("--weights", "none.safetensors"), "file 'none.safetensors' does not exist"),
        (("--limit-frames", 0), "Invalid value for '--limit-frames'"),
        (("--out", __file__), "Invalid value for '--out'"),
    ],
)
def test_wrong_use_of_run_is_one_message(clip_folder, tmp_path, words, message):
    valid = ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")
    valid = valid[:1] + valid[3:] if "--methods" in words else valid
    output = rlbench(*valid, *words, code=2)
    assert message in output
    assert "Traceback" not in output
    assert not (tmp_path / "r").exists()


def test_a_folder_without_a_clip_is_an_error(tmp_path):
    assert "error: no clip in" in rlbench("run", "-m", "mean", "--clips", tmp_path, code=2)


def test_a_plugin_file_is_run(clip_folder, tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine")
    words = ("--plugin", plugin, "--clips", clip_folder, "--out", tmp_path / "r")
    rlbench("run", "-m", "mine,mean", "-m", "mine/*", *words)
    assert set(table.read(tmp_path / "r")["method"]) == {"mine", "mine/B1", "mean"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1", "plugin.py has neither FAMILY nor METHODS"),
        ("import nothing_of_this_name", "ModuleNotFoundError: No module named"),
        ("\n1 / 0", "ZeroDivisionError: division by zero (line 2)"),
        ("def", "SyntaxError: invalid syntax"),
    ],
)
def test_a_broken_plugin_is_reported_in_one_line(text, message, tmp_path):
    (tmp_path / "plugin.py").write_text(text)
    output = rlbench("run", "-m", "mean", "--plugin", tmp_path / "plugin.py", code=2)
    assert message in output
    assert len(output) < 400


def test_the_reason_is_printed_where_there_is_no_number(clip_folder, tmp_path):
    plugin = write_plugin(tmp_path / "odd.py", "odd", body="raise RuntimeError('no luck')")
    words = ("--plugin", plugin, "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    output = rlbench("run", "-m", "odd", *words, code=1)  # nothing could be measured
    assert "1 skipped" in output
    assert "odd: no psnr on noise: RuntimeError: no luck" in output


def test_a_run_without_any_number_fails_again_when_it_is_repeated(clip_folder, tmp_path):
    words = ("run", "-m", "eaw", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 0.5)
    assert "1 skipped" in rlbench(*words, code=1)
    assert "nothing to do" in rlbench(*words, code=1)


def test_a_budget_that_is_given_twice_is_measured_once(run_mean):
    assert "1 cells measured" in rlbench(*run_mean, "--spp", "1,1.0")


def test_bf16_without_networks_is_reported(run_mean):
    output = rlbench(*run_mean, "--bf16")
    assert "--bf16 and --weights have no effect, because mean has no networks" in output


def test_a_cost_profile_that_lacks_fields_is_an_error_and_the_one_of_the_docs_works(
    run_mean, tmp_path
):
    words = (*run_mean, "--cost", tmp_path / "mine.toml")
    (tmp_path / "mine.toml").write_text("sample_ms = 10")
    output = rlbench(*words, code=2)
    assert "cost profile" in output
    assert "sample_ms" in output
    page = (CHECKOUT / "docs" / "how-to" / "charge-your-renderer.md").read_text()
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "mine.toml").write_text(example)
    rlbench(*words)


def test_reports_are_written_to_the_requested_folder(run_mean, tmp_path):
    rlbench(*run_mean, "--cost", "paper-2080ti")
    output = rlbench("report", "all", "--results", tmp_path / "r", "--out", tmp_path / "figures")
    assert f"{tmp_path}/figures/pareto.png" in output
    assert (tmp_path / "figures" / "summary.md").stat().st_size > 0


def test_report_all_skips_reports_without_rows_and_says_why(run_mean, tmp_path):
    words = ("--results", tmp_path / "r", "--out", tmp_path / "figures")
    rlbench(*run_mean, "--cost", "paper-2080ti")
    reason = "no family has its default"
    assert f"report ablation is skipped: {reason}" in rlbench("report", "all", *words)
    assert "error: cannot write ablation: " in rlbench("report", "ablation", *words, code=2)


@pytest.mark.parametrize("report", ["summary", "pareto"])
def test_scenes_of_one_cost_profile_are_reported_together(tmp_path, report):
    for scene in ("city", "temple", "foyer"):
        write_noise(tmp_path / "clips" / scene, scene)
    words = ("--clips", tmp_path / "clips", "--out", tmp_path / "r", "--cost", "paper-2080ti")
    rlbench("run", "-m", "mean", "--spp", "1,2", *words)
    rlbench("report", report, "--results", tmp_path / "r", "--out", tmp_path / "figures")


def test_report_all_writes_the_others_where_one_fails(run_mean, tmp_path):
    rlbench(*run_mean)
    words = ("--results", tmp_path / "r", "--out", tmp_path / "figures")
    output = rlbench("report", "all", *words, code=2)
    assert "error: cannot write" in output
    assert "no cell has psnr, plan_ms" in output
    assert (tmp_path / "figures" / "summary.md").stat().st_size > 0


def test_a_method_without_rows_is_an_error_of_report(run_mean, tmp_path):
    rlbench(*run_mean, "--spp", 1)
    words = ("report", "summary", "--results", tmp_path / "r")
    for missing in ("svgf", "mean@sede1"):
        output = rlbench(*words, "-m", f"mean,{missing}", code=2)
        assert f"has no rows of {missing}; available: mean" in output
    assert not (tmp_path / "r" / "report").exists()
    rlbench(*words, "-m", "all,mean")  # a pattern selects the rows that exist
    assert (tmp_path / "r" / "report" / "summary.md").is_file()  # beside its table


def test_rows_of_a_plugin_can_be_reported_without_it(clip_folder, tmp_path):
    plugin, out = write_plugin(tmp_path / "grey.py", "grey"), tmp_path / "r"
    rlbench("run", "-m", "grey,mean", "--plugin", plugin, "--clips", clip_folder, "--out", out)
    registry.clear_plugins()
    words = ("report", "summary", "--results", out, "--out", tmp_path / "figures")
    rlbench(*words, "-m", "grey")
    assert "| grey |" in (tmp_path / "figures" / "summary.md").read_text()
    output = rlbench(*words, "-m", "imcd", code=2)
    assert output.endswith("has no rows of imcd; available: grey, mean")


def test_a_budget_of_zero_is_reported(run_mean, tmp_path):
    rlbench(*run_mean, "--cost", "paper-2080ti", "--spp", "0,1")
    rlbench("report", "all", "--results", tmp_path / "r", "--out", tmp_path / "figures")
    assert (tmp_path / "figures" / "paper-spp.png").stat().st_size > 0


def test_a_report_without_results_is_an_error(tmp_path):
    assert "error: no results in" in rlbench("report", "--results", tmp_path, code=2)


def test_a_pattern_selects_rows_of_variants_without_shipped_weights(tmp_path):
    rows = table.to_dataframe(
        [Row("r", name, "a", "a", 1, 1, 0, "psnr", 20.0) for name in NOT_PRETRAINED]
    )
    selected = benchmark.select_rows(rows, ["ours/*"], tmp_path)
    assert set(selected["method"]) == set(NOT_PRETRAINED)
    with pytest.raises(OptionError, match="has no rows of svgf/"):
        benchmark.select_rows(rows, ["svgf/*"], tmp_path)


def test_regress_fails_where_quality_fell(run_mean, tmp_path):
    words = ("--results", tmp_path / "r", "--baseline", tmp_path / "base.json")
    rlbench(*run_mean)
    assert "4 entries written" in rlbench("regress", *words, "--update")
    assert "passed: 4 same" in rlbench("regress", *words)

    content = json.loads((tmp_path / "base.json").read_text())
    content["entries"][0]["psnr"] += 1
    (tmp_path / "base.json").write_text(json.dumps(content))
    assert "FAILED: 1 worse" in rlbench("regress", *words, code=1)


def test_regress_refuses_a_method_that_nobody_measured(run_mean, tmp_path):
    words = ("--results", tmp_path / "r", "--baseline", tmp_path / "base.json")
    rlbench(*run_mean, "--spp", 1)
    rlbench("regress", *words, "--update")
    assert "passed: 1 same" in rlbench("regress", *words, "--methods", "mean")
    output = rlbench("regress", *words, "--methods", "mean,maen", code=2)
    message = "error: --methods maen: neither the results nor the baseline have it; available: mean"
    assert message in output


def test_a_part_of_the_results_does_not_rewrite_the_baseline(run_mean, tmp_path):
    words = ("--results", tmp_path / "r", "--baseline", tmp_path / "base.json")
    rlbench(*run_mean, "--spp", 1)
    output = rlbench("regress", *words, "--methods", "mean", "--update", code=2)
    assert "error: --update rewrites the whole baseline" in output
    assert not (tmp_path / "base.json").exists()


@pytest.mark.slow
def test_a_killed_run_resumes_and_ends_as_an_undisturbed_one(tmp_path):
    for name in ("foyer", "attic", "cellar"):
        write_noise(tmp_path / "clips" / name, name, frames=4)
    slow = "import time; time.sleep(0.02); return samples.mean, None"
    plugin = write_plugin(tmp_path / "slow.py", "slow", body=slow)

    def words(out: str) -> list[str]:
        command = ["run", "-m", "slow", "--clips", str(tmp_path / "clips")]
        options = ["--plugin", str(plugin), "--out", str(tmp_path / out)]
        return ["-c", "from rlbench.cli.app import app; app()", *command, *options]

    child = subprocess.Popen([sys.executable, *words("killed")], cwd=CHECKOUT, env=ENVIRONMENT)
    while child.poll() is None and len(table.cells(tmp_path / "killed")) < 3:
        time.sleep(0.01)
    child.send_signal(signal.SIGKILL)
    child.wait()
    assert 0 < len(table.cells(tmp_path / "killed")) < 12

    output = python(*words("killed"))
    assert " 0 already in the results" not in output
    assert "0 skipped" in output
    python(*words("undisturbed"))
    assert scores(tmp_path / "killed") == scores(tmp_path / "undisturbed")
