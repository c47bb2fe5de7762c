"""PSNR does not fall below the baseline: a subset in `make test`, all in `make test-all`."""

from __future__ import annotations

import pytest

from rlbench import registry
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.regression import comparison
from rlbench.benchmark.regression.baseline import find_baseline, load_baseline
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import measure, read_cells
from rlbench.cli.regress import select_baseline
from rlbench.render.jobs.render_clips import ensure
from rlbench.render.mitsuba.variant import select_variant
from rlbench.system import paths

BASELINE = find_baseline("mini")


@pytest.fixture
def persistent_cache(request, monkeypatch):
    """A cache that outlives the test, because clips take a while to render."""
    monkeypatch.setenv("RLBENCH_CACHE", str(request.config.cache.mkdir("rlbench")))
    if select_variant().startswith("scalar"):
        pytest.skip("no libLLVM: the scalar tracer draws other samples than the baseline had")
    return paths.cache_folder()


def compare(results, scenes, methods, spp, subset) -> comparison.RegressionReport:
    clips = tuple(StoredSource(folder) for folder in ensure("mini", scenes))
    plan = RunPlan(methods, clips, spp)
    measure(plan, results, scores_only=True)
    rows, baseline = read_cells(plan, results), load_baseline(BASELINE)
    if subset:
        rows, baseline = select_baseline(rows, baseline, methods)
    return comparison.compare(rows, baseline, subset=subset)


def test_psnr_on_one_scene_equals_the_baseline(persistent_cache, tmp_path):
    methods = ("mean", "eaw", "svgf", "oidn", "oidn/retrained", "dasr", "ntas", "imcd", "ours")
    report = compare(tmp_path / "results", ("city",), methods, (1.0, 4.0), subset=True)
    assert report.has_passed, report.text()
    assert report.with_verdict("same"), report.text()  # something was compared


@pytest.mark.slow
def test_psnr_equals_the_baseline(persistent_cache, tmp_path):
    committed = load_baseline(BASELINE).entries
    methods = tuple(registry.expand({entry.method for entry in committed}))
    spp = tuple(sorted({entry.target_spp for entry in committed}))
    report = compare(tmp_path / "results", None, methods, spp, subset=False)
    assert report.has_passed, report.text()
