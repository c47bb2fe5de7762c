"""The examples in docs/how-to/add-a-metric.md and add-a-scene.md work as an installed package."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from rlbench import registry
from rlbench.apps.render.jobs.render_clips import preset_jobs
from rlbench.benchmark import results
from rlbench.clips.stored import open_clip
from rlbench.run import run_clip
from tests.cli.runner import rlbench
from tests.procedural_folder import write_world

PAGES = Path(__file__).parents[1] / "docs" / "how-to"


def install(page: str, site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package of a page's example, with the entry points that the page shows."""
    text = (PAGES / page).read_text()
    (code,) = re.findall(r'```python\n("""my_package/.*?)```', text, re.DOTALL)
    (group, points), *_ = re.findall(
        r'```toml\n\[project\.entry-points\."([\w.]+)"\]\n(.*?)```', text, re.DOTALL
    )
    package, information = site / "my_package", site / "my_package-1.dist-info"
    package.mkdir(parents=True)
    information.mkdir()
    (package / "__init__.py").touch()
    (package / re.search(r"my_package/(\w+\.py)", code)[1]).write_text(code)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1\n")
    (information / "entry_points.txt").write_text(f"[{group}]\n{points.replace(chr(34), '')}")
    monkeypatch.syspath_prepend(str(site))
    for name in ("my_package", "my_package.metrics", "my_package.scene"):
        monkeypatch.delitem(sys.modules, name, raising=False)


def test_the_metric_of_the_page_is_listed_and_scored(tmp_path, monkeypatch):
    install("add-a-metric.md", tmp_path / "site", monkeypatch)
    assert "worst_pixel" in rlbench("list", "metrics")
    clip = write_world(tmp_path / "clips" / "world")
    words = ("--clips", clip, "--spp", 1, "--times", "none", "--out", tmp_path / "r")
    rlbench("run", "-m", "mean", *words)
    rows = results.read(tmp_path / "r")
    scores = rows[rows["metric"] == "worst_pixel"].sort_values("frame")["value"]
    frames = run_clip(registry.load_method("mean"), open_clip(clip), 1.0)
    errors = [(each.image - each.frame.reference.mean).abs().max().item() for each in frames]
    assert scores.tolist() == pytest.approx(errors)


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_the_metric_of_the_page_is_finite_for_any_image(tmp_path, monkeypatch, value):
    install("add-a-metric.md", tmp_path / "site", monkeypatch)
    metric = registry.load_plugin("metrics", "worst_pixel")
    grey = torch.full((1, 3, 4, 5), 0.5)
    assert metric.score(metric.compare(grey * value, grey, grey)).isfinite().all()


def test_the_scene_of_the_page_is_listed_and_moves(tmp_path, monkeypatch):
    install("add-a-scene.md", tmp_path / "site", monkeypatch)
    assert "pyramid" in rlbench("list", "scenes")
    (job,) = preset_jobs("tiny", ["pyramid"], folder=tmp_path / "clips")
    before, after = (job.scene.vertex_animation(time)["pyramid"] for time in (0.0, 1.0))
    np.testing.assert_allclose(after - before, np.full((5, 3), [0.05, 0, 0]), atol=1e-6)
    assert "motion" in job.buffers


@pytest.mark.slow
def test_the_scene_of_the_page_renders_and_passes_the_linter(tmp_path, monkeypatch):
    install("add-a-scene.md", tmp_path / "site", monkeypatch)
    rlbench("render", "--preset", "tiny", "--scenes", "pyramid")
    clip = tmp_path / "cache" / "clips" / "tiny" / "pyramid"
    assert "failed: 0" in rlbench("lint", clip)
    words = ("--preset", "tiny", "--scenes", "pyramid", "--spp", 1, "--out", tmp_path / "r")
    assert "passed: no cell failed" in rlbench("run", "-m", "mean", *words, "--times", "none")
