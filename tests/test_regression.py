"""No committed PSNR may fall: a small subset in `make test`, all of it in `make test-all`."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench import registry
from rlbench.benchmark import regression
from rlbench.benchmark import results as table
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import measure
from rlbench.cli import benchmark
from rlbench.render.jobs.render_clips import ensure
from rlbench.render.mitsuba.llvm import select_variant
from rlbench.system import paths

BASELINE = Path(__file__).parent / "regression" / "mini.json"


@pytest.fixture
def kept_cache(request, monkeypatch):
    """A cache that outlives the test: clips take a while to render."""
    monkeypatch.setenv("RLBENCH_CACHE", str(request.config.cache.mkdir("rlbench")))
    if select_variant().startswith("scalar"):
        pytest.skip("no libLLVM: the scalar tracer draws other samples than the committed ones")
    return paths.cache()


def outcome(results, scenes, methods, spp, subset) -> regression.RegressionReport:
    clips = tuple(StoredSource(folder) for folder in ensure("mini", scenes))
    measure(RunPlan(methods, clips, spp, repeats=1), results)
    found, known = table.read(results), regression.load(BASELINE)
    if subset:
        found, known = benchmark.part(found, known, methods)
    return regression.compare(found, known, subset=subset)


def test_psnr_on_one_scene_is_what_was_committed(kept_cache, tmp_path):
    methods = ("mean", "eaw", "svgf", "oidn", "dasr", "ntas", "imcd", "ours")
    found = outcome(tmp_path / "results", ("city",), methods, (1.0, 4.0), subset=True)
    assert found.passed, found.text()
    assert found.of("same"), found.text()  # something was compared


@pytest.mark.slow
def test_psnr_is_what_was_committed(kept_cache, tmp_path):
    committed = regression.load(BASELINE).entries
    methods = tuple(registry.expand({entry.method for entry in committed}))
    spp = tuple(sorted({entry.spp for entry in committed}))
    found = outcome(tmp_path / "results", None, methods, spp, subset=False)
    assert found.passed, found.text()
