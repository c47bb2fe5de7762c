"""The public API: documented, lazily imported, and usable as the documentation shows."""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import rlbench
from rlbench import registry
from rlbench.benchmark.run_outcome import RunWarning
from tests.conftest import write_noise, write_plugin

ROOT = Path(__file__).parents[1]
GUIDE = (ROOT / "docs" / "how-to" / "add-a-method.md").read_text()
SNIPPETS = "\n".join(re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL))
GUARANTEED = [
    (str(node.module), alias.name)
    for node in ast.walk(ast.parse(SNIPPETS))
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
]
REFERENCE = (ROOT / "docs" / "reference" / "api.md").read_text()
LAZY = ["rlbench", "rlbench.ops", "rlbench.clips", "rlbench.training", "rlbench.checks.conformance"]
LIGHT = [
    "metrics.catalog",
    "metrics.flip",
    "flip_evaluator",
    "rlbench.pools",
    "rlbench.clips.header",
    "rlbench.benchmark.results",
    "rlbench.benchmark.regression.pages",
    "rlbench.cli.regress",
    "rlbench.apps.render.scenes.collection.catalog",
    "rlbench.system.provenance",
    *(f"rlbench.apps.render.scenes.{name}.scene" for name in ("city", "temple", "hall", "ripples")),
]
PUBLIC = [(module, name) for module in LAZY for name in importlib.import_module(module).__all__]


@pytest.mark.parametrize(("module", "name"), [*GUARANTEED, *PUBLIC])
def test_public_names_can_be_imported_and_have_a_docstring(module, name):
    thing = getattr(importlib.import_module(module), name)
    assert not name.startswith("_")
    if inspect.isfunction(thing) or inspect.isclass(thing):
        text = inspect.getdoc(thing) or f"{name}("
        assert not text.startswith(f"{name}(")  # what a dataclass writes where there is none


def test_names_on_rlbench_are_in_the_reference():
    assert re.findall(r"^\| `(\w+)` \|", REFERENCE, re.MULTILINE) == list(rlbench.__all__)
    modules = {"run": "api.run", "denoise": "denoise.denoise"}  # else those named so
    described = re.findall(r"^::: rlbench\.([\w.]+)$", REFERENCE, re.MULTILINE)
    assert {modules.get(name, name) for name in rlbench.__all__} <= set(described)


@pytest.mark.parametrize(
    "first", ["import rlbench.run, rlbench.denoise", "from rlbench.frames import Frame", "pass"]
)
def test_a_name_is_the_function_whatever_was_imported_before(first):
    check = "assert {type(rlbench.run), type(rlbench.denoise)} == {types.FunctionType}"
    code = f"{first}\nimport rlbench, types\n{check}"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    return write_noise(tmp_path / "clips" / "noise", h=24, w=32).parent


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("raise SystemExit(0)", "1 cell stopped by an error .odd on noise at 1 spp, seed 0"),
        ("return samples.mean / 0, None", "1 cell with images that are not finite .odd on noise"),
    ],
)
def test_run_warns_of_cells_without_the_numbers_that_were_requested(clips, tmp_path, body, message):
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", body=body))
    with pytest.warns(RunWarning, match=f"FAILED: {message}.*`note` has the reasons") as issued:
        rows = rlbench.run(["odd", "mean"], clips=[clips], spp=[1], out=tmp_path / "results")
    assert set(rows["method"]) == {"odd", "mean"}
    assert issued[0].filename == __file__


def test_run_returns_the_rows_of_the_call_and_measures_nothing_twice(clips, tmp_path):
    finished: list[object] = []
    options = {"clips": [clips], "spp": [1], "out": tmp_path / "results"}
    first = rlbench.run(["mean"], **options, on_cell=finished.append)
    psnr = first[(first["metric"] == "psnr") & (first["frame"] >= 0)]
    assert sorted(psnr["frame"]) == [0, 1, 2]
    assert (psnr["value"] > 0).all()
    rlbench.run(["mean", "eaw"], **options)
    files = {file: file.stat().st_mtime_ns for file in (tmp_path / "results").iterdir()}
    again = rlbench.run("mean", **options, on_cell=finished.append)  # one name is a method
    assert again["value"].equals(first["value"])
    assert {file: file.stat().st_mtime_ns for file in (tmp_path / "results").iterdir()} == files
    assert len(finished) == 2  # the known cell is announced too


def test_a_report_is_written_from_a_dataframe(clips, tmp_path):
    rows = rlbench.run(["mean"], clips=[clips], spp=[1], out=tmp_path / "results")
    files = rlbench.report("summary", rows, out=tmp_path / "report")
    assert (tmp_path / "report" / "summary.md") in files
    assert "mean" in (tmp_path / "report" / "summary.md").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scenes": "nowhere"}, "no scene nowhere; available: noise"),
        ({"device": "abacus"}, "device abacus cannot be used"),
        ({"takes": "all"}, "takes= applies to preset scenes only. With clips=, select"),
        ({"pool": "frozen"}, "no pool 'frozen'; available: stored, live"),
        ({"spp": ["1", "0"]}, "spp=['1', '0']: give numbers"),
        ({"spp": [1, float("nan")]}, "spp=[1, nan]: give numbers"),
        ({"spp": 16, "clips": None}, 'spp=16: the clips of preset.*trace more with pool="live"'),
        ({"seeds": "0,1"}, "seeds='0,1': give numbers, whole numbers from 0 on"),
        ({"limit_frames": 0}, "limit_frames=0: give a whole number of frames"),
        ({"times": "newest"}, 'times="newest": no such times; available: missing, uncertain'),
        ({"plugin": "nowhere.py"}, "no plugin file at .*nowhere.py. A plugin is a Python file"),
    ],
)
def test_wrong_arguments_raise_an_error_that_names_them_and_says_what_to_write(
    clips, tmp_path, options, message
):
    pattern = re.escape(message).replace(r"\.\*", ".*").replace(r"\ ", ".*?")
    with pytest.raises(rlbench.RlbenchError, match=pattern) as raised:
        rlbench.run(["mean"], **{"clips": [clips], "out": tmp_path, **options})
    assert "--" not in str(raised.value).partition("rlbench ")[0]


def test_one_budget_one_scene_one_folder_and_one_plugin_need_no_list(clips, tmp_path):
    plugin = write_plugin(tmp_path / "grey.py", "grey")
    options = {"times": "none", "out": tmp_path / "r", "limit_frames": 2}
    rows = rlbench.run("grey", plugin=plugin, clips=clips, scenes="noise", spp=2, **options)
    assert set(rows["method"]) == {"grey"}
    assert set(rows["target_spp"]) == {2.0}
    assert set(rows["frame"]) >= {0, 1}
    assert 2 not in set(rows["frame"])
    assert "grey" in rlbench.run(["grey"], clips=[clips], spp=[2], **options)["method"].to_list()


def test_a_frame_of_a_clip_is_tensors(clips):
    clip = rlbench.open_clip(clips / "noise")
    result = next(rlbench.run_clip(rlbench.load_method("mean"), clip, spp=2.0))
    assert clip.frame(0).gbuffer.albedo.shape == result.image.shape == (1, 3, 24, 32)
