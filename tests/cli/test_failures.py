"""A failure costs one cell of a run, or the rows of its plugin in another command."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench import registry
from rlbench.benchmark import results
from tests.cli.runner import rlbench
from tests.conftest import write_noise, write_plugin

UNIFORM = "return torch.ones_like(samples.counts, dtype=torch.float32)"
EXIT = "PluginExitError: plugin code called sys.exit(3)"
IMAGE = "return samples.mean * GAIN, None"
FAULTS = {  # what replaces a line of a method -> the reason in its row
    ("return None\n", "raise SystemExit(3)\n"): EXIT,  # in start
    (UNIFORM, "raise SystemExit(3)"): EXIT,
    ("return Scaled()", "import module_that_exits"): EXIT,
    (UNIFORM, "return samples.counts.numpy() / 1.0"): (
        "WrongReturnError: plan must return a density [1 1 20 24] as a torch.Tensor, found a "
        "ndarray [1 1 20 24] of float64; return a torch.Tensor, such as torch.from_numpy(density)"
    ),
    (IMAGE, "return samples.mean"): (
        "denoise must return (image, state), found a Tensor [1 3 20 24] of torch.float32; end"
    ),
}


@pytest.fixture
def clips(tmp_path):
    """A folder with a clip, beside which a test may write others."""
    write_noise(tmp_path / "clips" / "whole")
    return tmp_path / "clips"


def run(clips, methods, *words, code=1) -> str:
    options = ("--clips", clips, "--spp", 1, "--times", "none", "--out", clips.parent / "results")
    return rlbench("run", "-m", methods, *options, *words, code=code)


def notes(clips) -> dict[tuple[str, str], str]:
    """The note of the PSNR row of each cell that has no score."""
    rows = results.read(clips.parent / "results")
    rows = rows[(rows["metric"] == "psnr") & rows["value"].isna()]
    return {(row.method, row.clip): row.note for row in rows.itertuples()}


def scored(clips) -> set[tuple[str, str]]:
    rows = results.read(clips.parent / "results")
    rows = rows[(rows["metric"] == "psnr") & rows["value"].notna()]
    return set(zip(rows["method"], rows["clip"], strict=True))


def test_each_fault_of_a_method_costs_its_own_cell(clips, tmp_path, monkeypatch):
    (tmp_path / "module_that_exits.py").write_text("raise SystemExit(3)")
    monkeypatch.syspath_prepend(str(tmp_path))
    expected, words = {}, ()
    for number, ((line, replacement), reason) in enumerate(FAULTS.items()):
        file = write_plugin(tmp_path / f"bad{number}.py", f"bad{number}")
        assert line in file.read_text()
        file.write_text(file.read_text().replace(line, replacement))
        words = (*words, "--plugin", file)
        expected[file.stem] = reason
    output = run(clips, ",".join([*expected, "mean"]), *words)
    assert scored(clips) == {("mean", "whole")}
    found = {method: note for (method, _), note in notes(clips).items()}
    assert {name for name in expected if expected[name] not in found[name]} == set()
    assert "FAILED: 5 cells stopped by an error (bad0 on whole at 1 spp, seed 0, bad1 on" in output
    assert output.endswith("and 2 more)")


def test_each_damaged_file_costs_the_cell_of_its_clip(clips):
    expected = {}
    for kind in ("view", "pool.path", "referenceA", "referenceB"):
        missing = write_noise(clips / f"missing-{kind}") / f"{kind}.0001.exr"
        missing.unlink()
        cut = write_noise(clips / f"cut-{kind}") / f"{kind}.0001.exr"
        cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
        expected |= {file.parent.name: f"ClipError: {file} " for file in (missing, cut)}
    output = run(clips, "svgf")
    assert scored(clips) == {("svgf", "whole")}
    found = {clip: note for (_, clip), note in notes(clips).items()}
    assert {name for name in expected if expected[name] not in found[name]} == set()
    assert "FAILED: 8 cells stopped by an error (svgf on cut-pool.path at 1 spp" in output


BROKEN = {  # the whole plugin file -> the reason in its rows
    "raise SystemExit(3)": "PluginExitError: plugin code called sys.exit(3)",
    "import no_such_package": "ModuleNotFoundError: No module named 'no_such_package' (gone.py:1)",
    "FAMILY = None": "gone.py has none of FAMILY, METHODS, METRIC",
}


@pytest.mark.parametrize(("source", "reason"), BROKEN.items())
def test_a_plugin_file_that_cannot_be_imported_costs_its_own_cells(clips, tmp_path, source, reason):
    (tmp_path / "gone.py").write_text(source)
    broken = "gone/B1"
    output = run(clips, f"{broken},mean", "--plugin", tmp_path / "gone.py")
    said = "gone from --plugin gone.py cannot be imported: "
    assert output.startswith(said + reason.partition(" (")[0])
    assert scored(clips) == {("mean", "whole")}
    assert notes(clips)[broken, "whole"].startswith(f"PluginError: {said}")
    assert reason in notes(clips)[broken, "whole"]
    assert f"FAILED: 1 cell stopped by an error ({broken} on whole at 1 spp" in output


def test_a_method_that_cannot_be_imported_is_measured_once_it_can(clips, tmp_path):
    file = tmp_path / "gone.py"
    file.write_text("1 / 0")
    words = ("--plugin", file)
    run(clips, "mean,gone", *words)
    write_plugin(file, "gone")
    run(clips, "mean,gone", *words, code=0)
    assert scored(clips) == {("mean", "whole"), ("gone", "whole")}
    assert notes(clips) == {}


def test_all_gives_rows_to_a_plugin_file_that_cannot_be_imported(clips, tmp_path):
    (tmp_path / "gone.py").write_text("1 / 0")
    registry.use_plugin(tmp_path / "gone.py")
    with registry.with_broken(["all"]):
        assert {"gone", "mean"} <= set(registry.expand(["all"]))
    with pytest.raises(ZeroDivisionError):
        registry.load_family("gone")


@pytest.mark.parametrize("names", ["gone", "mean"])
def test_a_broken_plugin_file_is_an_error_at_once_where_it_is_alone_or_not_named(
    clips, tmp_path, names
):
    (tmp_path / "gone.py").write_text("raise SystemExit(3)")
    output = run(clips, names, "--plugin", tmp_path / "gone.py", code=2)
    assert output.endswith(
        "sys.exit(3). Raise an exception that says what is wrong instead (gone.py:1)"
    )
    assert not (tmp_path / "results").exists()


SECTION = "transformations"
PLUGIN_FAULTS = {  # what replaces a line of the plugin, and the reason in its rows
    "error at import": ("GAIN = 1.0", "import no_such_package", "No module named 'no_such_pack"),
    "error in FAMILY": ('FAMILY = Family(\n    "bad"', "FAMILY = Family(\n    1 / 0", "division"),
    "exit in build": ("return Scaled()", "raise SystemExit(3)", "plugin code called sys.exit(3)"),
    "exit in denoise": (IMAGE, "raise SystemExit(3)", "plugin code called sys.exit(3)"),
}
COMMANDS = {  # words, and what the output has once the rows of `mean` are done
    "run": (("run", "--clips", "clips", "--spp", 1, "--times", "none", "--out", "r"), "│ mean │ 1"),
    "check": (("check",), "✓ depend on no pixel beyond the receptive field"),
    "stress": (("stress", "--only", SECTION, "--quick", "--out", "s"), "mean: transformations ✓"),
    "speed": (("speed", "--sizes", 16, "--repeats", 1, "--out", "v"), "v/speed.csv"),
    "images": (("images", "--clips", "clips", "--spp", 1, "--out", "i"), "i/noise-1spp-02.png"),
}


def case(command: str, *fault: str):
    """A parameter set; the command images is that of an app."""
    marks = [pytest.mark.app("view")] if command == "images" else []
    return pytest.param(command, *fault, marks=marks)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, with a clip."""
    write_noise(tmp_path / "clips" / "noise")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def break_plugin(file: Path, fault: str) -> tuple[int, str]:
    """Put a fault into a plugin file; returns its line and the reason."""
    line, replacement, reason = PLUGIN_FAULTS[fault]
    before, found, after = write_plugin(file, "bad").read_text().partition(line)
    assert found
    file.write_text(before + replacement + after)
    return before.count("\n") + replacement.count("\n") + 1, reason


@pytest.mark.parametrize(
    ("command", "fault"),
    [
        *(case("check", fault) for fault in PLUGIN_FAULTS),
        *(case(command, "error at import") for command in COMMANDS if command != "check"),
        *(case(command, "exit in denoise") for command in COMMANDS if command != "check"),
    ],
)
def test_a_fault_costs_the_rows_of_its_plugin_and_all_others_are_done(folder, command, fault):
    number, reason = break_plugin(folder / "bad.py", fault)
    words, done = COMMANDS[command]
    output = rlbench(*words, "-m", "bad,mean", "--plugin", "bad.py", code=1)
    assert done in output
    assert reason in output
    assert f"(bad.py:{number})" in output


@pytest.mark.parametrize("command", map(case, COMMANDS))
def test_a_file_that_is_no_python_is_an_error_at_once(folder, command):
    words, done = COMMANDS[command]
    assert "no plugin file at" in rlbench(*words, "-m", "bad", "--plugin", "bad.py", code=2)
    (folder / "bad.py").write_text("x = 1\ndef build(:")
    output = rlbench(*words, "-m", "bad,mean", "--plugin", "bad.py", code=2)
    assert "bad.py is no Python code: SyntaxError: invalid syntax (bad.py:2)" in output
    assert done not in output
