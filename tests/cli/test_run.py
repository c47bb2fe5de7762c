"""The command run, on small clips."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from rlbench.benchmark import results as table
from rlbench.benchmark.results import Row
from rlbench.registry import shipped_weights
from tests.cli.runner import CHECKOUT, ENVIRONMENT, python, rlbench
from tests.conftest import write_noise, write_plugin


def scores(results: Path) -> list[tuple]:
    rows = table.read(results)
    is_time = rows["metric"].str.endswith("_ms") | rows["metric"].str.startswith(table.CLOCK_PREFIX)
    kept = rows[~is_time]
    return sorted(kept.itertuples(index=False, name=None), key=repr)


def test_run_prints_scores_and_where_the_results_are_and_repeats_nothing(run_mean, tmp_path):
    output = rlbench(*run_mean, "--times", "none")
    message = "4 cells measured, 0 already in the results, 0 skipped; results are in"
    assert f"{message} {tmp_path}/r" in output
    assert "PSNR" in output
    assert "nothing to do: all 4 cells are in" in rlbench(*run_mean, "--times", "none")
    file = min((tmp_path / "r").glob("*.parquet"))
    file.write_bytes(file.read_bytes()[:-9])
    output = rlbench(*run_mean, "--times", "none")
    assert f"a damaged row file was set aside as {file}.damaged" in output


def test_scores_of_another_device_are_not_averaged_in(run_mean, tmp_path):
    words = (*run_mean, "--spp", 1, "--times", "none")
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


def test_times_are_measured_again_without_scores(run_mean, tmp_path):
    words = (*run_mean, "--repeats", 1, "--spp")
    rlbench(*words, 1)
    before = scores(tmp_path / "r")
    output = rlbench(*words, "1,7", "--times", "again")
    assert "1 timed again, 1 without scores and not timed" in output
    assert scores(tmp_path / "r") == before
    assert "times =" not in (tmp_path / "r" / "run.toml").read_text()  # of this call alone


def test_uncertain_times_are_marked_and_can_be_measured_again(run_mean, tmp_path):
    rlbench(*run_mean, "--spp", 1, "--repeats", 1, "--keep-images")
    (cell,) = table.cells(tmp_path / "r")
    times = {"inference_ms": 10.0, "inference_low_ms": 8.0, "inference_high_ms": 12.5}
    rows = table.read(tmp_path / "r").dropna(subset=["value"])
    rows["value"] = rows["metric"].map(times).fillna(rows["value"])
    rows.loc[rows["metric"] == "inference_ms", "note"] = "uncertain: busy"
    table.write_cell(tmp_path / "r", cell, [Row(**row) for row in rows.to_dict("records")])
    output = rlbench(*run_mean, "--spp", 1, "--repeats", 1, "--keep-images")
    assert "│ 10.00 ±25 % │" in output
    assert "1 row has uncertain times, marked ±: busy" in output
    words = ("run", "--config", tmp_path / "r" / "run.toml", "--out", tmp_path / "r")
    assert shlex.join([str(word) for word in (*words, "--times", "uncertain")]) in output
    assert "1 timed again" in rlbench(*words, "--times", "uncertain")
    (row,) = table.read(tmp_path / "r").query("metric == 'inference_ms'").to_dict("records")
    assert row["value"] != 10.0


def test_clips_of_a_scene_are_selected_together_or_one_by_one(tmp_path):
    for name in ("attic", "attic-cut", "foyer"):
        write_noise(tmp_path / "clips" / name, name.partition("-")[0])
    words = ("run", "-m", "mean", "--clips", tmp_path / "clips", "--spp", 1, "--times", "none")
    rlbench(*words, "--out", tmp_path / "both", "--scenes", "attic")
    rlbench(*words, "--out", tmp_path / "one", "--scenes", "attic-cut")
    assert set(table.read(tmp_path / "both")["clip"]) == {"attic", "attic-cut"}
    assert set(table.read(tmp_path / "one")["clip"]) == {"attic-cut"}


def test_only_the_first_frames_are_run_on_request(run_mean, tmp_path):
    words = (*run_mean, "--spp", 1, "--times", "none")
    rlbench(*words, "--limit-frames", 2)
    assert set(table.read(tmp_path / "r")["frame"]) == {-1, 0, 1}
    output = rlbench(*words, "--limit-frames", 1)
    assert "1 cells measured, 0 already in the results, 0 skipped, 1 older ones replaced" in output


def test_a_run_with_an_image_that_is_not_finite_fails_each_time(clip_folder, tmp_path):
    body = "return samples.mean * float('inf'), None"
    plugin = write_plugin(tmp_path / "odd.py", "odd", body=body)
    words = ("--plugin", plugin, "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    words = (*words, "--times", "none")
    for message in ("2 cells measured", "nothing to do"):
        output = rlbench("run", "-m", "odd,mean", *words, code=1)
        assert message in output
        assert output.endswith(
            "FAILED: 1 cell with images that are not finite (odd on noise at 1 spp, seed 0)"
        )
    rlbench("run", "-m", "mean", *words)  # other cells of the folder do not count


def test_a_budget_that_a_method_does_not_support_is_no_failure(run_mean):
    output = rlbench(*run_mean, "-m", "eaw", "--spp", "0.5,1", "--times", "none")
    assert "1 skipped" in output
    assert output.endswith("passed: no cell failed, all images are finite")


def test_a_run_without_any_number_fails_again_when_it_is_repeated(clip_folder, tmp_path):
    words = ("run", "-m", "eaw", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 0.5)
    words = (*words, "--times", "none")
    assert "1 skipped" in rlbench(*words, code=1)
    assert "nothing to do" in rlbench(*words, code=1)


def test_the_cost_profile_of_the_docs_works_and_one_that_lacks_fields_is_an_error(
    run_mean, tmp_path
):
    words = (*run_mean, "--spp", 1, "--repeats", 1, "--cost", tmp_path / "mine.toml")
    (tmp_path / "mine.toml").write_text("sample_ms = 10")
    assert "sample_ms" in rlbench(*words, code=2)
    page = (CHECKOUT / "docs" / "how-to" / "charge-your-renderer.md").read_text()
    example = "\n".join(re.findall(r"```toml\n(.*?)```", page, re.DOTALL))
    assert "[inference_ms." in example
    (tmp_path / "mine.toml").write_text(example)
    rlbench(*words)


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


METRIC = """from metrics.metric import Metric


def score(frame):
    return (frame.image - frame.reference).abs().flatten(1).amax(1)


METRIC = Metric("worst_pixel", "", "lower", "linear", score)
"""


def test_a_metric_in_one_file_is_scored_by_run_and_evaluate(run_mean, tmp_path):
    file = tmp_path / "worst.py"
    file.write_text(METRIC)
    words = ("--plugin", file, "--spp", 1, "--times", "none")
    rlbench(*run_mean, *words, "--keep-images")
    rows = table.read(tmp_path / "r").query("metric == 'worst_pixel'")
    assert rows["value"].gt(0).all()
    clips = ("--clips", run_mean[run_mean.index("--clips") + 1], "--out", tmp_path / "e")
    rlbench("evaluate", tmp_path / "r", "--metrics", "worst_pixel", *clips, *words[:2])
    again = table.read(tmp_path / "e").query("metric == 'worst_pixel'")
    assert sorted(again["value"]) == pytest.approx(sorted(rows["value"]), rel=1e-3)  # half
    file.write_text(METRIC.replace("amax(1)", "amax(1) * 2"))
    other = python("-m", "rlbench", *map(str, (*run_mean, *words)))
    assert "nothing to do" not in other  # its code decides whether a cell is current


def test_a_run_writes_its_options_and_another_reads_them(run_mean, tmp_path):
    rlbench(*run_mean, "--spp", 1, "--limit-frames", 1, "--times", "none")
    config = tmp_path / "r" / "run.toml"
    assert "limit-frames = 1" in config.read_text()
    words = ("run", "--config", config, "--out", tmp_path / "r")
    assert "nothing to do: all 1 cells" in rlbench(*words)
    assert "2 cells measured" in rlbench(*words, "--spp", "2,4")  # the command line wins
    config.write_text("methodes = 'mean'\n")
    assert "no option 'methodes'. Did you mean 'methods'?" in rlbench(*words, code=2)
    config.write_text("methods = [")
    assert "run.toml is not TOML" in rlbench(*words, code=2)


def test_a_run_at_a_size_renders_it_and_its_file_of_options_repeats_it(tmp_path):
    words = ("run", "--out", tmp_path / "r")
    options = ("--preset", "tiny", "--scenes", "temple", "--size", "32x24", "--times", "none")
    rlbench(*words, "-m", "mean", "--spp", 1, *options)
    rows = table.read(tmp_path / "r")
    assert (set(rows["size"]), set(rows["preset"])) == ({"32x24"}, {"tiny-32x24"})
    config = tmp_path / "r" / "run.toml"
    assert 'size = "32x24"' in config.read_text()
    assert "nothing to do: all 1 cells" in rlbench(*words, "--config", config)
    printed = rlbench("render", "--preset", "tiny-32x24", "--scenes", "temple", "--motion")
    assert "tiny-32x24/temple motion in pixels a frame: median" in printed
    other = (*words, "--config", config, "--size", "24x24")
    assert "exist for preset tiny-32x24 and would be overwritten" in rlbench(*other, code=2)


def test_a_config_of_somebody_else_runs_no_code_and_writes_nowhere_else(run_mean, tmp_path):
    config, plugin = tmp_path / "run.toml", tmp_path / "theirs.py"
    plugin.write_text("from pathlib import Path\nPath(__file__).with_name('ran').touch()\n")
    words = ("run", "--config", config)
    for text in (f'plugin = ["{plugin}"]\n', 'engine = "ray=10.0.0.1:1"\n'):
        config.write_text(text)
        assert "add --allow-plugins" in rlbench(*words, "--out", tmp_path / "r", code=2)
    config.write_text(f'plugin = ["{plugin}"]\nout = "{tmp_path / "r"}"\n')
    assert not (tmp_path / "ran").exists()
    assert "Name it yourself: --out" in rlbench(*words, "--allow-plugins", code=2)
    rlbench(*run_mean[:3], *words[1:], "--allow-plugins", "--out", tmp_path / "r", code=2)
    assert (tmp_path / "ran").exists()


def test_weights_of_one_method_are_not_given_to_others(clip_folder, tmp_path):
    file = shipped_weights("ours/A1")
    words = ("--clips", clip_folder, "--spp", 1, "--out", tmp_path / "r", "--times", "none")
    rlbench("run", "-m", "ours/A1,oidn/tuned", "--weights", f"ours/A1={file}", *words)
    assert set(table.read(tmp_path / "r")["method"]) == {"ours/A1@A1", "oidn/tuned"}
    output = rlbench("run", "-m", "ours", "--weights", f"ours/A1={file}", *words, code=2)
    assert "ours/A1 is none of the methods" in output


def test_a_folder_in_brackets_is_a_name(run_mean, tmp_path):
    folder = tmp_path / "res[bold]"
    output = rlbench(*run_mean[:-1], folder, "--spp", 1, "--times", "none")
    assert f"results are in {folder}".replace(" ", "") in output.replace(" ", "")  # it is wrapped
