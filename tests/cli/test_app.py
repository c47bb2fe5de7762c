"""The command line, on tiny clips of one's own."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rlbench import errors, registry
from rlbench.benchmark import results as table
from rlbench.benchmark.results import Row
from rlbench.cli import arguments, benchmark
from rlbench.cli.app import app
from rlbench.render.jobs import preset_clips
from rlbench.render.presets import PRESETS
from rlbench.training import dataset
from tests.conftest import write_noise, write_plugin

CHECKOUT = Path(__file__).parents[2]
COMMANDS = (
    "run",
    "images",
    "list",
    "render",
    "import",
    "lint",
    "train",
    "crossval",
    "check",
    "report",
    "regress",
    "doctor",
)
UNSHIPPED = ("ours", "ours/encoder-small", "ours/encoder-large@seed1")


def rlbench(*words: object, code: int = 0) -> str:
    """What a command prints, errors included."""
    found = CliRunner().invoke(app, [str(word) for word in words])
    assert found.exit_code == code, found.output
    return " ".join(found.output.split())


def scores(results: Path) -> list[tuple]:
    rows = table.read(results)
    kept = rows[~rows["metric"].str.endswith("_ms")]
    return sorted(kept.itertuples(index=False, name=None), key=repr)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_has_an_example(command):
    assert f"rlbench {command}" in rlbench(command, "--help").split("Examples:")[1]


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom typer.testing import CliRunner\nfrom rlbench.cli.app import app\n"
        "assert 'regress' in CliRunner().invoke(app, ['--help']).output\n"
        "print({'torch', 'mitsuba', 'pandas', 'numpy', 'matplotlib'} & set(sys.modules))"
    )
    assert _python("-c", code) == "set()\n"


def test_run_measures_and_says_where_results_are(clip_folder, tmp_path):
    told = rlbench("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")
    assert f"4 cells measured, 0 known before, 0 not possible; results are in {tmp_path}/r" in told
    assert "PSNR" in told


def test_numbers_of_another_device_are_not_averaged_in(clip_folder, tmp_path):
    words = ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    rlbench(*words)
    own = table.read(tmp_path / "r")
    others = [Row(**row) for row in own.assign(device="abacus").to_dict("records")]
    others = [replace(row, value=0.0 if row.value == row.value else row.value) for row in others]
    table.write_cell(tmp_path / "r", "mean noise 1spp seed0 abacus 0", others)
    psnr = own[own["metric"] == "psnr"]["value"].mean()
    assert f"│ mean │ 1 │ {psnr:.2f} │" in rlbench(*words)


def test_the_same_run_again_does_nothing_and_says_so(clip_folder, tmp_path):
    words = ("run", "--methods", "mean", "--clips", clip_folder, "--out", tmp_path / "r")
    rlbench(*words)
    assert "nothing to do: all 4 cells are in" in rlbench(*words)


def test_clips_may_be_a_folder_of_clips_and_are_chosen_by_scene(tmp_path):
    for scene in ("foyer", "attic"):
        write_noise(tmp_path / "clips" / scene, scene)
    words = ("run", "-m", "mean", "--clips", tmp_path / "clips", "--out", tmp_path / "r")
    rlbench(*words, "--scenes", "attic", "--spp", "1,2")
    assert set(table.read(tmp_path / "r")["scene"]) == {"attic"}


def test_clips_of_a_scene_are_chosen_together_or_one_by_one(tmp_path):
    for name in ("attic", "attic-cut", "foyer"):
        write_noise(tmp_path / "clips" / name, name.partition("-")[0])
    words = ("run", "-m", "mean", "--clips", tmp_path / "clips", "--spp", 1)
    rlbench(*words, "--out", tmp_path / "both", "--scenes", "attic")
    rlbench(*words, "--out", tmp_path / "one", "--scenes", "attic-cut")
    assert set(table.read(tmp_path / "both")["clip"]) == {"attic", "attic-cut"}
    assert set(table.read(tmp_path / "one")["clip"]) == {"attic-cut"}


def test_only_the_first_frames_are_run_if_asked(clip_folder, tmp_path):
    words = ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    rlbench(*words, "--limit-frames", 2)
    assert set(table.read(tmp_path / "r")["frame"]) == {-1, 0, 1}
    told = rlbench(*words, "--limit-frames", 1)
    assert "1 cells measured, 0 known before, 0 not possible, 1 older ones replaced" in told


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--methods", "foo"), "error: 'foo' is not a method; there are: dasr, eaw, imcd, mean"),
        (("--methods", "mean/A9"), "error: 'mean' has no variant 'A9'; it has: mean"),
        (("--spp", "one"), "error: --spp takes numbers such as 0.5,1,2 and was given 'one'"),
        (("--spp", "-1"), "error: --spp takes numbers"),
        (("--spp", "nan"), "error: --spp takes numbers"),
        (("--spp", "1,inf"), "error: --spp takes numbers"),
        (("--cost", "mine"), "error: no cost profile 'mine'; there are: measured, paper-2080ti"),
        (("--device", "abacus"), "error: --device abacus cannot be used here"),
        (("--scenes", "cellar"), "error: --scenes cellar: the clips given show: noise"),
        (("--scenes", "noise,celar"), "error: --scenes celar: the clips given show: noise"),
        (("--plugin", "nowhere.py"), "error: no plugin file at"),
        (("--takes", "main"), "error: --takes is of a preset's scenes; of --clips"),
    ],
)
def test_what_cannot_be_done_is_one_clear_message(clip_folder, tmp_path, words, told):
    fine = ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")
    fine = fine[:1] + fine[3:] if "--methods" in words else fine
    found = rlbench(*fine, *words, code=2)
    assert told in found
    assert "Traceback" not in found


def test_a_folder_without_a_clip_is_told(tmp_path):
    assert "error: no clip in" in rlbench("run", "-m", "mean", "--clips", tmp_path, code=2)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--preset", "huge"), "error: no preset 'huge'; available: tiny, mini"),
        (("--scenes", "cellar"), "error: no scene 'cellar'; available: city, generated"),
        (
            ("--scenes", "city-crane"),
            "error: scene 'city' has no take 'crane'; it has: static, cut",
        ),
        (("--seeds", "48:0"), "error: --seeds takes a range such as 0:48"),
        (("--takes", "some"), "error: --takes was given 'some'; it must be main or all"),
        (("--retime", "--scene", "x.xml"), "error: --retime is of a preset's clips"),
        (("--seeds", "a"), "and was given 'a'"),
        (("--seeds", "0:48", "--scene", "x.xml"), "without --scenes and --seeds"),
    ],
)
def test_what_cannot_be_rendered_is_told(words, told):
    assert told in rlbench("render", *words, code=2)


@pytest.mark.parametrize(
    ("text", "seeds"),
    [("0:3", (0, 1, 2)), ("7", (7,)), ("3,1", (3, 1)), ("0:2,9,1:3", (0, 1, 9, 2)), (None, None)],
)
def test_seeds_are_ranges_without_their_end_and_lists(text, seeds):
    assert arguments.seeds(text) == seeds


def test_render_and_train_ask_for_the_clips_of_the_seeds(monkeypatch):
    wanted = []

    def ensure(plan, scenes, seeds, executor):
        wanted.append((plan.name, scenes, seeds))
        return []

    monkeypatch.setattr("rlbench.render.jobs.render_clips.ensure", ensure)
    rlbench("render", "--preset", "train", "--seeds", "0:48")
    dataset.split_generated("train", (30, 31))
    dataset.split_generated("mini", (30, 31))  # generated scenes, as large as those of mini
    whole = tuple(range(48))
    assert wanted == [
        ("train", None, whole),
        ("train", None, (30, 31)),
        ("mini", None, (30, 31)),
    ]


@pytest.mark.parametrize(("asked_for", "takes"), [(None, "all"), ("main", "main")])
def test_the_takes_of_a_preset_can_be_chosen(monkeypatch, asked_for, takes):
    wanted = []
    monkeypatch.setattr(
        "rlbench.render.jobs.render_clips.ensure", lambda plan, *_, **__: wanted.append(plan)
    )
    preset_clips.render_preset_clips(None, "standard", takes=asked_for)
    assert [(plan.name, plan.takes) for plan in wanted] == [("standard", takes)]


def test_a_scene_held_out_is_neither_trained_on_nor_validated_on(monkeypatch):
    def ensure(plan, scenes, seeds, executor):
        return [Path(plan.name, str(name)) for name in scenes or seeds]

    monkeypatch.setattr("rlbench.render.jobs.render_clips.ensure", ensure)
    held = dataset.select_split("standard", None, "hall")
    assert held.train == [Path("standard", name) for name in ("city", "temple", "ripples")]
    assert held.validation == [Path("train", "0"), Path("train", "14")]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--holdout", "attic"), "preset 'mini' has: city, temple, hall,"),
        (
            ("--holdout", "hall", "--preset", "train"),
            "needs a preset with named scenes, and 'train' has none",
        ),
        (("--holdout", "hall", "--seeds", "0:9"), "--seeds applies to generated scenes only"),
    ],
)
def test_what_cannot_be_held_out_is_told(words, told):
    assert told in rlbench("train", "-m", "oidn", *words, code=2)


@pytest.mark.parametrize("command", ["train", "crossval"])
@pytest.mark.parametrize(
    ("budget", "told"),
    [
        ("0.5", "'ntas' cannot be trained at 0.5 spp: supports 1 to 8 spp"),
        ("lots", "--budget takes numbers such as 0.5,1,2 and was given 'lots'"),
    ],
)
def test_a_budget_that_cannot_be_trained_for_is_told_before_anything_is_rendered(
    command, budget, told
):
    assert told in rlbench(command, "-m", "ntas", "--budget", budget, code=2)


def test_one_clip_is_too_few_to_train_on():
    told = rlbench("train", "-m", "oidn", "--seeds", "7", code=2)
    assert "error: --seeds 7 gives one clip. Training needs at least 2 clips" in told


def test_a_loose_file_is_listed_and_runs(clip_folder, tmp_path):
    plugin = write_plugin(tmp_path / "mine.py", "mine")
    found = json.loads(CliRunner().invoke(app, ["list", "--json", "--plugin", str(plugin)]).output)
    assert "mine/B1" in [row["name"] for row in found["methods"]]
    words = ("--plugin", plugin, "--clips", clip_folder, "--out", tmp_path / "r")
    rlbench("run", "-m", "mine,mean", "-m", "mine/*", *words)
    assert set(table.read(tmp_path / "r")["method"]) == {"mine", "mine/B1", "mean"}


def test_a_broken_plugin_is_listed_as_broken(tmp_path):
    (tmp_path / "torn.py").write_text("1 / 0")
    told = rlbench("list", "methods", "--plugin", tmp_path / "torn.py")
    assert "torn (from --plugin torn.py) is broken: ZeroDivisionError" in told


def test_a_reason_is_shown_where_there_is_no_number(clip_folder, tmp_path):
    plugin = write_plugin(tmp_path / "odd.py", "odd", body="raise RuntimeError('no luck')")
    words = ("--plugin", plugin, "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    told = rlbench("run", "-m", "odd", *words, code=1)  # nothing could be measured
    assert "1 not possible" in told
    assert "odd: no psnr on noise: RuntimeError: no luck" in told


def test_a_run_without_any_number_fails_again_when_it_is_repeated(clip_folder, tmp_path):
    words = ("run", "-m", "eaw", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 0.5)
    assert "1 not possible" in rlbench(*words, code=1)
    assert "nothing to do" in rlbench(*words, code=1)


def test_a_method_without_rows_is_never_left_out_of_a_report_in_silence(clip_folder, tmp_path):
    rlbench("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    words = ("report", "summary", "--results", tmp_path / "r")
    for absent in ("svgf", "mean@sede1"):
        told = rlbench(*words, "-m", f"mean,{absent}", code=2)
        assert f"has no rows of {absent}; it has: mean" in told
    assert not (tmp_path / "r" / "report").exists()
    rlbench(*words, "-m", "all,mean")  # a pattern takes what is there
    assert (tmp_path / "r" / "report" / "summary.md").is_file()  # beside the table it is of


@pytest.mark.parametrize("preset", ["tiny", "mini", "standard", "paper", "unseen"])
def test_nothing_is_trained_on_what_is_scored(preset):
    told = rlbench("train", "-m", "oidn", "--preset", preset, code=2)
    assert f"error: preset '{preset}' is a test set" in told
    assert told.endswith("Choose: train")


def test_no_generated_scene_is_trained_on_that_is_scored():
    told = rlbench("train", "-m", "oidn", "--seeds", "70:82", code=2)
    assert "--seeds 80, 81: these belong to test set 'unseen'" in told
    seeds = {plan.is_test_set: set(plan.seeds) for plan in PRESETS.values() if plan.seeds}
    assert not seeds[True] & seeds[False]


def test_a_budget_asked_for_twice_is_measured_once(clip_folder, tmp_path):
    words = ("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")
    assert "1 cells measured" in rlbench(*words, "--spp", "1,1.0")


def test_what_learns_nothing_is_told():
    assert "mean has nothing to train" in rlbench("train", "-m", "mean")


@pytest.mark.parametrize("kind", ["methods", "metrics", "scenes", "reports", "pools", "presets"])
def test_list_is_the_same_for_scripts_and_for_people(kind):
    rows = json.loads(CliRunner().invoke(app, ["list", kind, "--json"]).output)[kind]
    assert all(row["name"] in rlbench("list", kind) for row in rows)


def test_a_narrow_terminal_shows_every_word_of_a_list(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    told = rlbench("list", "methods")
    assert "…" not in told


def test_images_says_which_sheets_it_wrote_and_who_is_missing(clip_folder, tmp_path):
    words = ("images", "-m", "mean,eaw", "--clips", clip_folder, "--spp", 0.5, "--out", tmp_path)
    told = rlbench(*words)
    assert f"{tmp_path}/noise-0.5spp-02.png" in told
    assert "noise-0.5spp-02.png is without eaw: supports 1 to 8 spp" in told


def test_the_version_is_that_of_the_package():
    assert rlbench("--version").strip() == importlib.metadata.version("rlbench")


def test_list_says_what_a_method_is_and_needs():
    (row, *_) = json.loads(CliRunner().invoke(app, ["list", "methods", "--json"]).output)["methods"]
    assert {"name", "paper", "licence", "needs", "spp", "adapts", "question"} <= set(row)


@pytest.mark.parametrize("words", [("--cap", 64), ("--views", "object"), ("--takes", "all")])
def test_what_belongs_to_presets_is_refused_for_a_scene_of_ones_own(words, tmp_path):
    told = rlbench("render", "--scene", tmp_path / "k.xml", *words, code=2)
    assert f"error: {words[0]} is of a preset's clips, not of --scene" in told


def test_regress_fails_where_quality_fell(clip_folder, tmp_path):
    words = ("--results", tmp_path / "r", "--baseline", tmp_path / "base.json")
    rlbench("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")
    assert "4 entries" in rlbench("regress", *words, "--update")
    assert "passed: 4 same" in rlbench("regress", *words)

    content = json.loads((tmp_path / "base.json").read_text())
    content["entries"][0]["psnr"] += 1
    (tmp_path / "base.json").write_text(json.dumps(content))
    assert "FAILED: 1 worse" in rlbench("regress", *words, code=1)


def test_a_method_that_nobody_measured_does_not_pass(clip_folder, tmp_path):
    words = ("--results", tmp_path / "r", "--baseline", tmp_path / "base.json")
    rlbench("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    rlbench("regress", *words, "--update")
    told = rlbench("regress", *words, "--only", "mean,maen", code=2)
    assert "error: --only maen: neither results nor baseline have it; there is: mean" in told


def test_a_baseline_is_not_rewritten_by_a_part(clip_folder, tmp_path):
    words = ("--results", tmp_path / "r", "--baseline", tmp_path / "base.json")
    rlbench("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r", "--spp", 1)
    told = rlbench("regress", *words, "--only", "mean", "--update", code=2)
    assert "error: --update writes the whole baseline anew" in told
    assert not (tmp_path / "base.json").exists()


def test_a_pattern_finds_rows_of_variants_that_are_not_shipped(tmp_path):
    found = table.to_dataframe(
        [Row("r", name, "a", "a", 1, 1, 0, "psnr", 20.0) for name in UNSHIPPED]
    )
    assert set(benchmark.rows(found, ["ours/*"], tmp_path)["method"]) == set(UNSHIPPED)


def test_reports_are_written_where_asked(clip_folder, tmp_path):
    words = ("--clips", clip_folder, "--out", tmp_path / "r", "--cost", "paper-2080ti")
    rlbench("run", "-m", "mean", *words)
    told = rlbench("report", "all", "--results", tmp_path / "r", "--out", tmp_path / "figures")
    assert f"{tmp_path}/figures/pareto.png" in told
    assert (tmp_path / "figures" / "summary.md").stat().st_size > 0


def test_report_all_goes_on_without_reports_whose_rows_are_not_there(clip_folder, tmp_path):
    words = ("--results", tmp_path / "r", "--out", tmp_path / "figures")
    rlbench(
        "run",
        "-m",
        "mean",
        "--clips",
        clip_folder,
        "--out",
        tmp_path / "r",
        "--cost",
        "paper-2080ti",
    )
    assert "ablation was not written: no family has its default" in rlbench("report", "all", *words)
    assert "error: ablation not written" in rlbench("report", "ablation", *words, code=2)


@pytest.mark.parametrize("report", ["summary", "pareto"])
def test_scenes_of_one_cost_profile_are_reported_together(tmp_path, report):
    for scene in ("city", "temple", "foyer"):
        write_noise(tmp_path / "clips" / scene, scene)
    words = ("--clips", tmp_path / "clips", "--out", tmp_path / "r", "--cost", "paper-2080ti")
    rlbench("run", "-m", "mean", "--spp", "1,2", *words)
    rlbench("report", report, "--results", tmp_path / "r", "--out", tmp_path / "figures")


def test_reports_that_can_be_written_are_though_another_cannot(clip_folder, tmp_path):
    rlbench("run", "-m", "mean", "--clips", clip_folder, "--out", tmp_path / "r")
    words = ("--results", tmp_path / "r", "--out", tmp_path / "figures")
    told = rlbench("report", "all", *words, code=2)
    assert "not written: no cell has psnr, plan_ms" in told
    assert (tmp_path / "figures" / "summary.md").stat().st_size > 0


def test_rows_of_a_plugin_can_be_reported_without_it(clip_folder, tmp_path):
    plugin, out = write_plugin(tmp_path / "grey.py", "grey"), tmp_path / "r"
    rlbench("run", "-m", "grey,mean", "--plugin", plugin, "--clips", clip_folder, "--out", out)
    registry.clear_plugins()
    words = ("report", "summary", "--results", out, "--out", tmp_path / "figures")
    rlbench(*words, "-m", "grey")
    assert "| grey |" in (tmp_path / "figures" / "summary.md").read_text()
    told = rlbench(*words, "-m", "imcd", code=2)
    assert told.endswith("has no rows of imcd; it has: grey, mean")


def test_a_budget_of_nothing_is_reported(clip_folder, tmp_path):
    out, words = tmp_path / "r", ("--cost", "paper-2080ti", "--spp", "0,1")
    rlbench("run", "-m", "mean", "--clips", clip_folder, "--out", out, *words)
    rlbench("report", "all", "--results", out, "--out", tmp_path / "figures")
    assert (tmp_path / "figures" / "paper-spp.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x = 1", "plugin.py has neither FAMILY nor METHODS"),
        ("import nothing_of_this_name", "ModuleNotFoundError: No module named"),
        ("\n1 / 0", "ZeroDivisionError: division by zero (line 2)"),
        ("def", "SyntaxError: invalid syntax"),
    ],
)
def test_a_broken_plugin_is_told_in_one_line(text, told, tmp_path):
    (tmp_path / "plugin.py").write_text(text)
    words = ("--plugin", tmp_path / "plugin.py")
    assert told in (line := rlbench("run", "-m", "mean", *words, code=2))
    assert len(line) < 400
    assert "is broken" in rlbench("list", "methods", *words)


def test_all_goes_on_without_a_broken_family_and_says_so(monkeypatch, capsys):
    monkeypatch.setenv(registry.METHODS_VARIABLE, "torn=nowhere_at_all:FAMILY")
    assert arguments.methods(["all"]) == tuple(
        n for n in registry.list_plugins("methods") if n != "torn"
    )
    assert "'all' skips torn, which cannot be imported: ModuleNotFound" in capsys.readouterr().err
    with pytest.raises(ModuleNotFoundError):
        arguments.methods(["mean,torn"])


@pytest.mark.parametrize("content", [None, b"junk"])
def test_a_replay_of_no_halted_training_is_told(tmp_path, content):
    file = tmp_path / "halted.safetensors"
    if content:
        file.write_bytes(content)
    assert "is not a file written by a training run" in rlbench("train", "--replay", file, code=2)


def test_a_file_is_no_results_folder(tmp_path):
    (tmp_path / "r").touch()
    assert "is a file; results are a folder" in rlbench("run", "--out", tmp_path / "r", code=2)


def test_a_cost_profile_says_what_it_lacks(clip_folder, tmp_path):
    (tmp_path / "mine.toml").write_text("sample_ms = 10")
    words = ("--clips", clip_folder, "--out", tmp_path / "r", "--cost", tmp_path / "mine.toml")
    told = rlbench("run", "-m", "mean", *words, code=2)
    assert "default_ms, device, height, sample_ms, scene_ms, source, title, width" in told
    page = (Path(__file__).parents[2] / "docs" / "cost.md").read_text()
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "mine.toml").write_text(example)
    rlbench("run", "-m", "mean", *words)


def test_what_has_no_networks_is_not_halved_in_silence(clip_folder, tmp_path):
    words = ("--clips", clip_folder, "--out", tmp_path / "r", "--half")
    assert "no method that was asked for has networks" in rlbench("run", "-m", "mean", *words)


def test_a_report_without_results_is_told(tmp_path):
    assert "error: no results in" in rlbench("report", "--results", tmp_path, code=2)


def test_doctor_says_which_path_tracer_and_device_there_is():
    told = rlbench("doctor")
    assert "path tracer" in told
    assert "torch" in told


@pytest.mark.slow
def test_a_run_that_was_killed_ends_as_an_undisturbed_one(tmp_path):
    for name in ("foyer", "attic", "cellar"):
        write_noise(tmp_path / "clips" / name, name, frames=4)
    slow = "import time; time.sleep(0.02); return samples.mean, None"
    plugin = write_plugin(tmp_path / "slow.py", "slow", body=slow)

    def words(out: str) -> list[str]:
        fixed = ["run", "-m", "slow", "--clips", str(tmp_path / "clips"), "--plugin", str(plugin)]
        return [
            "-c",
            "from rlbench.cli.app import app; app()",
            *fixed,
            "--out",
            str(tmp_path / out),
        ]

    child = subprocess.Popen([sys.executable, *words("killed")], cwd=CHECKOUT, env=_env())
    while child.poll() is None and len(table.cells(tmp_path / "killed")) < 3:
        time.sleep(0.01)
    child.send_signal(signal.SIGKILL)
    child.wait()
    assert 0 < len(table.cells(tmp_path / "killed")) < 12

    told = _python(*words("killed"))
    assert " 0 known before" not in told
    assert "0 not possible" in told
    _python(*words("undisturbed"))
    assert scores(tmp_path / "killed") == scores(tmp_path / "undisturbed")


def _env() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1"}


def _python(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, *words], cwd=CHECKOUT, env=_env(), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (None, ("", None)),
        ("random", ("", "random")),
        ("a.safetensors", ("", "a.safetensors")),
        ("seed1=a.safetensors", ("seed1", "a.safetensors")),
        ("ppo-pixel+surrogate=a.safetensors", ("ppo-pixel+surrogate", "a.safetensors")),
    ],
)
def test_weights_may_be_named(text, found, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.safetensors").touch()
    assert arguments.weights(text) == found


@pytest.mark.parametrize("words", [["--norm", "-1"], ["--norm", "0"], ["--minutes", "0"]])
def test_a_training_by_numbers_that_teach_nothing_is_refused(words, tmp_path):
    asked_for = ["train", "-m", "oidn", "--out", str(tmp_path / "runs"), *words]
    told = CliRunner().invoke(app, asked_for).output
    assert f"{words[0]} {words[1]}: it has to be above 0" in told
    assert not (tmp_path / "runs").exists()


def test_weights_that_are_not_there_are_told_before_anything_runs():
    with pytest.raises(errors.OptionError, match="no file b.safetensors; 'rlbench train'"):
        arguments.weights("seed1=b.safetensors")


def test_a_name_of_weights_that_no_row_could_have_is_refused():
    with pytest.raises(errors.OptionError, match="letters, digits"):
        arguments.weights("a@b=file")
    with pytest.raises(errors.OptionError, match="METHOD@half is what rows of another kind"):
        arguments.weights("half-a=file")
