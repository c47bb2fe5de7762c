"""A failure costs one cell: the others are measured, and the last line names it."""

from __future__ import annotations

import pytest

from rlbench import registry
from rlbench.api import run as rlbench_run
from rlbench.benchmark import results
from rlbench.benchmark.run_outcome import RunWarning
from tests.cli.runner import rlbench
from tests.conftest import install_plugin, write_noise, write_plugin

UNIFORM = "return torch.ones_like(samples.counts, dtype=torch.float32)"
EXIT = "PluginExitError: plugin code called sys.exit(3)"
FAULTS = {  # what replaces a line of a method -> the reason in its row
    ("return None\n", "raise SystemExit(3)\n"): EXIT,  # in start
    (UNIFORM, "raise SystemExit(3)"): EXIT,
    ("return samples.mean * GAIN, None", "raise SystemExit(3)"): EXIT,
    ("return Scaled()", "raise SystemExit(3)"): EXIT,
    ("return Scaled()", "import module_that_exits"): EXIT,
    (UNIFORM, "return samples.counts.numpy() / 1.0"): (
        "WrongReturnError: plan must return a density [1 1 20 24] as a torch.Tensor, found a "
        "ndarray [1 1 20 24] of float64; return a torch.Tensor, such as torch.from_numpy(density)"
    ),
    ("return samples.mean * GAIN, None", "return samples.mean.numpy(), None"): (
        "denoise must return an image [1 3 h w] as a torch.Tensor, found a ndarray [1 3 20 24] of "
        "float32; return a torch.Tensor, such as torch.from_numpy(image)"
    ),
    ("return samples.mean * GAIN, None", "return samples.mean"): (
        "denoise must return (image, state), found a Tensor [1 3 20 24] of torch.float32; end"
    ),
    ("return samples.mean * GAIN, None", "pass"): (
        "denoise must return (image, state), found None; end `denoise` with `return image, state`"
    ),
}


@pytest.fixture
def clips(tmp_path):
    """A folder with a clip, beside which a test may write others."""
    write_noise(tmp_path / "clips" / "whole")
    return tmp_path / "clips"


def run(clips, methods, *words, code=1) -> str:
    folder = clips.parent / "results"
    return rlbench(
        "run",
        "-m",
        methods,
        "--clips",
        clips,
        "--spp",
        1,
        "--times",
        "none",
        "--out",
        folder,
        *words,
        code=code,
    )


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
    assert "FAILED: 9 cells stopped by an error (bad0 on whole at 1 spp, seed 0, bad1 on" in output
    assert output.endswith("and 6 more)")


def damage(file, how):
    if how == "missing":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def test_each_damaged_file_costs_the_cell_of_its_clip(clips):
    expected = {}
    for how in ("missing", "truncated"):
        for kind in ("view", "pool.path", "referenceA", "referenceB"):
            file = write_noise(clips / f"{how}-{kind}") / f"{kind}.0001.exr"
            damage(file, how)
            expected[file.parent.name] = f"ClipError: {file} "
    output = run(clips, "svgf")
    assert scored(clips) == {("svgf", "whole")}
    found = {clip: note for (_, clip), note in notes(clips).items()}
    assert {name for name in expected if expected[name] not in found[name]} == set()
    assert "FAILED: 8 cells stopped by an error (svgf on missing-pool.path at 1 spp" in output


def test_a_file_that_is_restored_is_measured_by_the_next_run(clips):
    file = write_noise(clips / "worn") / "view.0001.exr"
    content = file.read_bytes()
    damage(file, "missing")
    run(clips, "svgf")
    file.write_bytes(content)
    output = run(clips, "svgf", code=0)
    assert "1 cells measured, 1 already in the results" in output
    assert scored(clips) == {("svgf", "whole"), ("svgf", "worn")}
    assert notes(clips) == {}


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


def test_an_installed_method_that_cannot_be_imported_costs_its_own_cells(
    clips, tmp_path, monkeypatch
):
    install_plugin(tmp_path, monkeypatch, "methods", "gone = no_such_package:FAMILY")
    run(clips, "mean,gone")
    assert scored(clips) == {("mean", "whole")}
    assert "gone from strange cannot be imported" in notes(clips)["gone", "whole"]


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


def test_python_runs_the_others_where_a_method_cannot_be_imported(clips, tmp_path):
    (tmp_path / "gone.py").write_text("1 / 0")
    registry.use_plugin(tmp_path / "gone.py")
    with pytest.warns(RunWarning, match="gone on whole"):
        rlbench_run(["mean", "gone"], clips=[clips], spp=[1], out=tmp_path / "results")
    assert scored(clips) == {("mean", "whole")}
    assert "ZeroDivisionError: division by zero" in notes(clips)["gone", "whole"]


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
