"""The examples of the how-to pages work, and the notebook runs from top to bottom."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest
import torch
from nbclient import NotebookClient

from rlbench import registry
from rlbench.apps.render.jobs import render_clips
from rlbench.benchmark import results
from rlbench.clips.stored import open_clip
from rlbench.run import run_clip
from rlbench.weights import read_card
from tests.cli.runner import rlbench
from tests.conftest import install_plugin
from tests.procedural_folder import write_world

DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs the package of a page's example, with the entry points that the page shows."""

    def install_page(page: str) -> None:
        text = (DOCS / "how-to" / page).read_text()
        (code,) = re.findall(r'```python\n("""my_package/.*?)```', text, re.DOTALL)
        (group, points), *_ = re.findall(
            r'```toml\n\[project\.entry-points\."rlbench\.(\w+)"\]\n(.*?)```', text, re.DOTALL
        )
        package = tmp_path / "site" / "my_package"
        package.mkdir(parents=True)
        (package / re.search(r"my_package/(\w+\.py)", code)[1]).write_text(code)
        points = points.replace('"', "")
        install_plugin(package.parent, monkeypatch, group, points, "my_package")
        for name in ("my_package", "my_package.metrics", "my_package.scene"):
            monkeypatch.delitem(sys.modules, name, raising=False)

    return install_page


def test_the_metric_of_the_page_is_listed_and_scored(install, tmp_path):
    install("add-a-metric.md")
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
def test_the_metric_of_the_page_is_finite_for_any_image(install, value):
    install("add-a-metric.md")
    metric = registry.load_plugin("metrics", "worst_pixel")
    grey = torch.full((1, 3, 4, 5), 0.5)
    assert metric.score(metric.compare(grey * value, grey, grey)).isfinite().all()


def test_the_scene_of_the_page_is_listed_and_moves(install, tmp_path):
    install("add-a-scene.md")
    assert "pyramid" in rlbench("list", "scenes")
    (job,) = render_clips.preset_jobs("tiny", ["pyramid"], folder=tmp_path / "clips")
    before, after = (job.scene.vertex_animation(time)["pyramid"] for time in (0.0, 1.0))
    np.testing.assert_allclose(after - before, np.full((5, 3), [0.05, 0, 0]), atol=1e-6)
    assert "motion" in job.buffers


@pytest.mark.slow
def test_the_scene_of_the_page_renders_and_passes_the_linter(install, tmp_path):
    install("add-a-scene.md")
    rlbench("render", "--preset", "tiny", "--scenes", "pyramid")
    clip = tmp_path / "cache" / "clips" / "tiny" / "pyramid"
    assert "failed: 0" in rlbench("lint", clip)
    words = ("--preset", "tiny", "--scenes", "pyramid", "--spp", 1, "--out", tmp_path / "r")
    assert "passed: no cell failed" in rlbench("run", "-m", "mean", *words, "--times", "none")


def test_the_method_of_the_page_trains_and_its_weights_beat_the_mean(tmp_path, monkeypatch):
    """On three small clips: rendering generated scenes takes minutes."""
    worlds = [write_world(tmp_path / "clips" / f"world-{seed}", seed) for seed in range(3)]
    monkeypatch.setattr(render_clips, "ensure", lambda *_, **__: worlds)
    page = (DOCS / "how-to" / "train-a-method.md").read_text()
    plugin, weights = tmp_path / "blur.py", tmp_path / "runs" / "blur" / "blur.safetensors"
    (snippet,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    plugin.write_text(snippet)
    options = ("--plugin", plugin, "--frames", 180, "--crop", 32, "--device", "cpu")
    assert "blur" in rlbench("train", "-m", "blur", *options, "--out", tmp_path / "runs")
    assert read_card(weights).frames_seen == 180
    options = ("--plugin", plugin, "--clips", worlds[0], "--out", tmp_path / "r", "--spp", 1)
    rlbench("run", "-m", "blur", *options, "--weights", weights)
    rlbench("run", "-m", "mean", *options)
    rows = results.read(tmp_path / "r")
    psnr = rows[rows["metric"] == "psnr"].groupby("method")["value"].mean()
    assert psnr["blur"] > psnr["mean"] + 1  # dB; the clip validates, so it was not trained on


@pytest.mark.slow
def test_the_tour_runs_and_ends_with_a_plot():
    notebook = nbformat.read(DOCS / "start" / "tour.ipynb", as_version=4)
    NotebookClient(notebook, timeout=600, kernel_name="python3").execute()
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert any("image/png" in output.get("data", {}) for output in code[-1].outputs)
