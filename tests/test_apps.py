"""The benchmark stands without its apps and experiments: fewer commands, and nothing else."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from rlbench.cli.commands import list_commands
from rlbench.registry.apps import load_apps

CHECKOUT = Path(__file__).parents[1]
REMOVED = ("dumps", "view", "cluster")  # apps; the tests of the rest need the one that renders
FOLDERS = (
    "research",
    "tests/research",
    *(f"{root}/{app}" for root in ("rlbench/apps", "tests/apps") for app in REMOVED),
)
DESCRIBING = ("test_readme.py", "test_site_pages.py", "test_claims.py")  # pages, of all apps
IGNORED = [f"--ignore=tests/{name}" for name in ("test_apps.py", "apps", *DESCRIBING)]


@pytest.fixture(scope="module")
def core(tmp_path_factory) -> tuple[Path, dict[str, str]]:
    """A copy of the tracked files without three apps and the experiments, as if installed."""
    copy = tmp_path_factory.mktemp("core") / "rlbench"
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=CHECKOUT, capture_output=True, check=True, text=True
    )
    for name in filter(None, listed.stdout.split("\0")):
        if not name.startswith(tuple(f"{folder}/" for folder in FOLDERS)):
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(CHECKOUT / name, copy / name)
    project = copy / "pyproject.toml"
    names = tuple(f"rlbench.apps.{app}" for app in REMOVED)
    lines = project.read_text().splitlines(keepends=True)
    project.write_text("".join(x for x in lines if not any(name in x for name in names)))
    installed = copy / "installed"
    _write_metadata(tomllib.loads(project.read_text())["project"], installed)
    return copy, {**os.environ, "PYTHONPATH": f"{copy}{os.pathsep}{installed}"}


def _write_metadata(project: dict, folder: Path) -> None:
    """Write what pip would: the name of the package and its entry points."""
    written = folder / f"rlbench-{project['version']}.dist-info"
    written.mkdir(parents=True)
    header = ["Metadata-Version: 2.1", "Name: rlbench", f"Version: {project['version']}"]
    for extra, packages in project["optional-dependencies"].items():
        header.append(f"Provides-Extra: {extra}")
        header += [
            f'Requires-Dist: {each.partition(";")[0]}; extra == "{extra}"' for each in packages
        ]
    written.joinpath("METADATA").write_text("\n".join(header) + "\n")
    groups = {"console_scripts": project["scripts"], **project["entry-points"]}
    written.joinpath("entry_points.txt").write_text(
        "\n".join(
            f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in points.items())
            for group, points in groups.items()
        )
    )


def _run(core: tuple[Path, dict[str, str]], *words: str) -> subprocess.CompletedProcess[str]:
    folder, environment = core
    command = [sys.executable, "-m", *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.slow
def test_without_apps_the_help_lists_fewer_commands(core):
    help_text = _run(core, "rlbench", "--help-all").stdout
    removed = {name for app in REMOVED for name in load_apps()[app].commands}
    for command in list_commands():
        assert (f"\n  {command} " in help_text) == (command not in removed)
    missing = _run(core, "rlbench", "view", "results")
    assert (missing.returncode, "No such command 'view'" in missing.stderr) == (2, True)


@pytest.mark.slow
def test_without_apps_the_tests_of_the_benchmark_pass(core):
    tested = _run(core, "pytest", "tests", *IGNORED, "-q", "-n", "2", "--dist", "loadfile")
    assert tested.returncode == 0, tested.stdout[-5000:]
