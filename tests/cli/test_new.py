"""The command new: what it makes works at once, and a bad name makes nothing."""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from setuptools import build_meta

from rlbench.apps.render import SCENE_TEMPLATE
from rlbench.benchmark import results
from rlbench.cli.new import TEMPLATES
from tests.cli.runner import CHECKOUT, ENVIRONMENT, rlbench
from tests.procedural_folder import write_world
from tests.test_api import GUARANTEED, PUBLIC

ALL = ("--learned", "--metric", "--scene")
SOURCES = sorted(file for folder in (TEMPLATES, SCENE_TEMPLATE) for file in folder.rglob("*.py"))


@pytest.fixture
def make(tmp_path, monkeypatch):
    """Makes a package in a folder of its own, where later commands are given."""
    monkeypatch.chdir(tmp_path)

    def make_package(name: str, *options: str) -> Path:
        rlbench("new", name, *options)
        return tmp_path / name

    return make_package


def install(folder: Path, site: Path) -> dict[str, str]:
    """What an editable install leaves in a site folder, and the environment that finds both."""
    site.mkdir()
    before = Path.cwd()
    os.chdir(folder)  # where a build backend runs
    try:
        build_meta.prepare_metadata_for_build_editable(str(site))
    finally:
        os.chdir(before)
    paths = os.pathsep.join(map(str, (folder, site, CHECKOUT)))
    return {**ENVIRONMENT, "PYTHONPATH": paths}


def python(*words: object, cwd: Path, env: dict[str, str]) -> str:
    command = [sys.executable, *map(str, words)]
    process = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


@pytest.mark.parametrize("options", [(), ("--learned",)])
def test_a_new_method_passes_every_check_without_being_installed(make, options):
    folder = make("fresh", *options)
    output = rlbench("check", "fresh", "--plugin", folder / "fresh")
    assert "failed: 0" in output
    assert "1 method checked; none failed" in output


def test_a_new_method_is_scored_without_being_installed(make, tmp_path):
    folder, clip = make("scored"), write_world(tmp_path / "clips" / "world")
    words = ("--plugin", folder / "scored", "--clips", clip, "--spp", 1, "--times", "none")
    assert "passed: no cell failed" in rlbench("run", "-m", "scored,mean", *words)


def test_the_tests_of_an_installed_package_pass(make, tmp_path):
    folder = make("whole", *ALL)
    env = install(folder, tmp_path / "site")
    quick = ("-p", "no:cacheprovider", "-k", "not contract")  # which `rlbench check` tests above
    assert "8 passed" in python("-m", "pytest", "-q", *quick, cwd=folder, env=env)
    code = "from rlbench import list_installed as l; print(*[r['name'] for k in "
    code += "('methods', 'metrics', 'scenes') for r in l(k)[k] if 'whole' in r['name']])"
    output = python("-c", code, cwd=tmp_path, env=env)
    assert output.split() == ["whole", "whole_worst_pixel", "whole_scene"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("my-method", "for example my_method"),
        ("2fast", "'2fast' cannot name a method and its package"),
        ("class", "'class' cannot name"),
        ("all", "'all' cannot name"),
        ("ours/new", "for example ours_new"),
        ("../up", "for example up"),
        ("", "for example my_method"),
        ("ours", "a method 'ours' exists already, in rlbench"),
        ("torch", "a Python module 'torch' is installed already"),
        ("taken", "error: taken exists already. Choose another NAME, or a folder with --out"),
    ],
)
def test_a_name_that_cannot_be_used_makes_nothing(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").mkdir()
    assert message in rlbench("new", name, code=2)
    assert [path.name for path in tmp_path.rglob("*") if path.name != "cache"] == ["taken"]


def test_a_scene_needs_an_app_that_renders_and_nothing_is_written_without_one(
    monkeypatch, tmp_path
):
    monkeypatch.setattr("rlbench.registry.apps.load_apps", dict)
    folder = tmp_path / "lonely"
    output = rlbench("new", "lonely", "--scene", "--out", folder, code=2)
    assert "--scene: no installed app renders scenes" in output
    assert not folder.exists()


@pytest.mark.parametrize("file", SOURCES, ids=lambda file: str(file.relative_to(CHECKOUT)))
def test_templates_use_documented_names_alone(file):
    documented = {*GUARANTEED, *PUBLIC, ("metrics.metric", "Metric")}
    documented |= {("metrics.metric", name) for name in ("Comparison", "Tensor")}
    nodes = [n for n in ast.walk(ast.parse(file.read_text())) if isinstance(n, ast.ImportFrom)]
    used = {(n.module, a.name) for n in nodes if not n.level for a in n.names}
    used = {pair for pair in used if pair[0].partition(".")[0] in ("rlbench", "metrics")}
    assert used - documented == set()
    assert all(hasattr(importlib.import_module(module), name) for module, name in used)


@pytest.mark.slow
def test_a_new_learned_method_trains_quickly_and_is_better_than_the_mean(make, tmp_path):
    plugin = ("--plugin", make("student", "--learned") / "student")
    rlbench("train", "-m", "student", "--quick", "--device", "cpu", *plugin)
    weights = tmp_path / "runs" / "student-quick" / "student.safetensors"
    words = ("--clips", write_world(tmp_path / "clips" / "world", seed=50), "--spp", 1)
    rlbench("run", "-m", "student,mean", "--weights", weights, *words, *plugin, "--times", "none")
    rows = results.read(tmp_path / "results")
    psnr = rows[rows["metric"] == "psnr"].groupby("method")["value"].mean()
    assert psnr["student"] > psnr["mean"] + 3  # dB
