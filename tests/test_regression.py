"""PSNR does not fall below the baseline.

`make test` compares every row on a small rendered clip, `make test-all` on preset mini.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from rlbench import registry
from rlbench.apps.render.jobs.render_clips import ensure
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.regression import comparison
from rlbench.benchmark.regression.baseline import find_baseline, load_baseline
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import measure, read_cells
from rlbench.system import paths

SMALL = Path(__file__).parent / "tiny.json"  # written by `make baseline`, as the one that ships


@pytest.fixture
def persistent_cache(request, monkeypatch):
    """A cache that outlives the test, because clips take a while to render."""
    monkeypatch.setenv("RLBENCH_CACHE", str(request.config.cache.mkdir("rlbench")))
    if select_variant().startswith("scalar"):
        pytest.skip("no libLLVM: the scalar tracer draws other samples than the baseline had")
    return paths.cache_folder()


def compare(results: Path, file: Path) -> comparison.RegressionReport:
    """Every row of a baseline, scored anew on its scenes at its budgets."""
    baseline = load_baseline(file)
    entries = baseline.entries
    methods = tuple(registry.expand({entry.method for entry in entries}))
    scenes = sorted({entry.scene for entry in entries})
    clips = tuple(StoredSource(folder) for folder in ensure(baseline.preset, scenes))
    plan = RunPlan(methods, clips, tuple(sorted({entry.target_spp for entry in entries})))
    measure(plan, results, times="none")
    return comparison.compare(read_cells(plan, results), baseline)


def test_psnr_of_every_row_equals_that_of_a_small_baseline(persistent_cache, tmp_path):
    report = compare(tmp_path / "results", SMALL)
    assert report.has_passed, report.text()
    assert report.with_verdict("same"), report.text()  # something was compared


@pytest.mark.slow
def test_psnr_equals_the_baseline_that_ships(persistent_cache, tmp_path):
    report = compare(tmp_path / "results", find_baseline("mini"))
    assert report.has_passed, report.text()
