"""The shape of the whole: what is installed, what is imported, who may read a clock."""

from __future__ import annotations

import ast
import graphlib
import importlib
import importlib.metadata
import re
import tomllib
from pathlib import Path

import grimp
import pytest

CHECKOUT = Path(__file__).parents[1]
PACKAGES = ("rlbench", "baselines", "methods", "metrics", "reports")
SOURCES = sorted(
    file for name in (*PACKAGES, "research") for file in (CHECKOUT / name).rglob("*.py")
)
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
CLOCK = r"perf_counter|monotonic\(|time\.time\(|process_time|cuda\.Event\("
MAX_LINES = 450  # of a module
TIMED = (  # what measures, what stops in time, and what writes down the cost of a sample
    "rlbench/benchmark/clock.py",
    "rlbench/system/load.py",
    "rlbench/training/loop.py",
    "rlbench/parallel/executor.py",
    "methods/ours/gradients/compare_learners.py",
    "research/profile_training.py",
    "rlbench/apps/render/mitsuba/tracer.py",
    "rlbench/apps/render/cycles/worker/worker.py",
)


def of(file: Path) -> str:
    return file.relative_to(CHECKOUT).as_posix()


@pytest.mark.parametrize("group", PROJECT["entry-points"])
def test_installed_entry_points_are_those_of_pyproject(group):
    ours = importlib.metadata.distribution("rlbench").entry_points.select(group=group)
    assert {p.name: p.value for p in ours} == PROJECT["entry-points"][group]


def test_packages_are_those_of_this_checkout():
    files = [importlib.import_module(name).__file__ for name in PACKAGES]
    assert [Path(str(file)).parent for file in files] == [CHECKOUT / name for name in PACKAGES]


@pytest.mark.parametrize(
    ("pattern", "allowed"),
    [
        pytest.param(CLOCK, TIMED, id="only a few modules read a clock"),
        pytest.param(
            r"torch\.load(?!\([^()]*, weights_only=True\))|import pickle|allow_pickle=True",
            (),
            id="nothing is unpickled",
        ),
        pytest.param(
            r"(?<!class )\bRow\(",
            ("rlbench/benchmark/scoring.py", "rlbench/benchmark/results.py"),
            id="only the bench makes rows",
        ),
        pytest.param(
            r"integrator\.sample\(|mi\.render\(",
            ("rlbench/apps/render/mitsuba/open_tracer.py",),
            id="light is traced in one place",
        ),
        pytest.param(r"\A(?!\"\"\"[^\n]*\S)", (), id="a module begins with what it is"),
    ],
)
def test_no_module_but_those_allowed_matches(pattern, allowed):
    matching = {of(file) for file in SOURCES if re.search(pattern, file.read_text())}
    assert matching <= set(allowed)


def test_modules_are_short_enough_to_read_and_names_say_what_they_hold():
    vague = {"told", "asked", "looked", "foreseen", "shown", "made", "whole", "wanted"}
    for file in SOURCES:
        text = file.read_text()
        assert len(text.splitlines()) <= MAX_LINES, of(file)
        nodes = ast.walk(ast.parse(text))
        assert not vague & {node.id for node in nodes if isinstance(node, ast.Name)}, of(file)


def test_packages_import_each_other_without_cycles():
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=False, cache_dir=None)
    units = {module: _unit(module) for module in graph.modules}
    imports: dict[str, set[str]] = {unit: set() for unit in units.values()}
    for module, unit in units.items():
        imported = {units[name] for name in graph.find_modules_directly_imported_by(module)}
        imports[unit] |= imported - {unit, "rlbench"}
    imports.pop("rlbench")  # its public names, imported lazily
    imports.pop("rlbench.__main__")  # the command line under another name
    graphlib.TopologicalSorter(imports).prepare()  # raises CycleError


def _unit(module: str) -> str:
    """A top-level package, or a module or package directly in rlbench."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "rlbench" else parts[0]
