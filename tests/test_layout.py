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
SOURCES = sorted(file for name in PACKAGES for file in (CHECKOUT / name).rglob("*.py"))
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
CLOCK = re.compile(r"perf_counter|monotonic\(|time\.time\(|process_time|cuda\.Event\(")
TIMED = (  # what measures, what stops in time, and what writes down the cost of a sample
    "rlbench/benchmark/clock/stopwatch.py",
    "rlbench/training/loop.py",
    "rlbench/parallel/time_limit.py",
    "methods/ours/experiments/compare_learners.py",
    "rlbench/training/profiler.py",
    "rlbench/render/mitsuba/tracer.py",
    "rlbench/render/cycles/worker/worker.py",
)


def of(file: Path) -> str:
    return file.relative_to(CHECKOUT).as_posix()


@pytest.mark.parametrize("group", PROJECT["entry-points"])
def test_installed_entry_points_are_those_of_pyproject(group):
    ours = importlib.metadata.distribution("rlbench").entry_points.select(group=group)
    assert {p.name: p.value for p in ours} == PROJECT["entry-points"][group]


@pytest.mark.parametrize("name", PACKAGES)
def test_packages_are_those_of_this_checkout(name):
    assert Path(str(importlib.import_module(name).__file__)).parent == CHECKOUT / name


@pytest.mark.parametrize("file", SOURCES, ids=of)
def test_a_module_begins_with_what_it_is(file):
    assert re.match(r'"""[^\n]*\S', file.read_text())


@pytest.mark.parametrize("file", SOURCES, ids=of)
def test_only_few_read_a_clock(file):
    assert of(file) in TIMED or not CLOCK.search(file.read_text())


@pytest.mark.parametrize("call", [r"integrator\.sample\(", r"mi\.render\("])
def test_light_is_traced_at_one_place(call):
    calls = [of(file) for file in SOURCES for _ in re.finditer(call, file.read_text())]
    wanted = {"i": "rlbench/render/mitsuba/wavefront.py", "m": "rlbench/render/mitsuba/scalar.py"}
    assert calls == [wanted[call[0]]]


@pytest.mark.parametrize("file", SOURCES, ids=of)
def test_nothing_is_unpickled(file):
    safe = re.sub(r"torch\.load\([^()]*, weights_only=True\)", "", file.read_text())
    assert not re.search(r"torch\.load|import pickle|allow_pickle=True", safe)


@pytest.mark.parametrize("file", [f for f in SOURCES if "scenes" not in of(f)], ids=of)
def test_modules_are_short_enough_to_read(file):
    assert len(file.read_text().splitlines()) <= 300


@pytest.mark.parametrize(
    "file", [f for f in SOURCES if of(f) != "rlbench/benchmark/scoring.py"], ids=of
)
def test_only_the_bench_makes_rows(file):
    made = re.search(r"(?<!class )\bRow\(", file.read_text())
    assert not made or of(file) == "rlbench/benchmark/results.py"


def test_the_package_has_eleven_modules_and_eleven_packages():
    entries = [path for path in (CHECKOUT / "rlbench").iterdir() if not path.name.startswith("__")]
    assert len([path for path in entries if path.suffix == ".py"]) == 11
    assert len([path for path in entries if (path / "__init__.py").is_file()]) == 11


def test_imports_form_few_units_on_few_levels_without_cycles():
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=False, cache_dir=None)
    units = {module: _unit(module) for module in graph.modules}
    imports: dict[str, set[str]] = {unit: set() for unit in units.values()}
    for module, unit in units.items():
        imported = {units[name] for name in graph.find_modules_directly_imported_by(module)}
        imports[unit] |= imported - {unit, "rlbench"}
    imports.pop("rlbench")  # its public names, imported lazily
    imports.pop("rlbench.__main__")  # the command line under another name
    levels = 0
    order = graphlib.TopologicalSorter(imports)
    order.prepare()  # raises CycleError
    while order.is_active():
        ready = order.get_ready()
        order.done(*ready)
        levels += 1
    assert len(imports) <= 26
    assert levels <= 9


def _unit(module: str) -> str:
    """A top-level package, or a module or package directly in rlbench."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "rlbench" else parts[0]


@pytest.mark.parametrize("file", SOURCES, ids=of)
def test_names_say_what_they_hold(file):
    names = {
        node.id for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Name)
    }
    assert not names & {"told", "asked", "looked", "foreseen", "shown", "made", "whole", "wanted"}
