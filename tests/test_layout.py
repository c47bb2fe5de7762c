"""The shape of the whole: what is installed, what is imported, who may read a clock."""

from __future__ import annotations

import importlib
import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[1]
PACKAGES = ("rlbench", "baselines", "methods", "metrics", "reports")
SOURCES = sorted(file for name in PACKAGES for file in (CHECKOUT / name).rglob("*.py"))
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
CLOCK = re.compile(r"perf_counter|monotonic\(|time\.time\(|process_time|cuda\.Event\(")
TIMED = (  # what measures, what stops in time, and what writes down the cost of a sample
    "rlbench/benchmark/latency.py",
    "rlbench/training/loop.py",
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
