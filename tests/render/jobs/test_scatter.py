"""The factor of scattered samples: what is traced, and what is compared."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from rlbench import registry
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.cost import FULL_FRAME
from rlbench.benchmark.run_plan import CellLoader, RunPlan, list_cells
from rlbench.benchmark.timing import ScatterMeter
from rlbench.render.jobs.job import Job
from rlbench.render.jobs.live_pool import open_wavefronts, scatter_factor
from rlbench.render.jobs.render_clips import render_clip
from rlbench.render.presets import Preset
from tests.conftest import write_noise
from tests.render.small_scenes import room

PRESET = Preset("test", "tests", (16, 24), 4, 2, pool_spp=4)


class CountingTracer:
    """A tracer whose sample of a full frame costs 1, and any other sample 1.25."""

    height, width = 2, 3

    def __init__(self):
        self.traced = []

    def trace(self, pixels, samples, stream):
        self.traced = list(zip(pixels.tolist(), samples.tolist(), strict=True))

    def relative_cost(self, work, spp):
        work()
        return 1.25 * len(self.traced) / (spp * self.height * self.width)


def test_the_factor_is_per_sample_and_of_the_methods_own_counts():
    tracer = CountingTracer()
    counts = torch.tensor([[2, 0, 1], [0, 0, 3]]).view(1, 1, 2, 3)
    assert scatter_factor(tracer, counts) == pytest.approx(1.25)
    assert tracer.traced == [(0, 0), (0, 1), (2, 0), (5, 0), (5, 1), (5, 2)]


def test_counts_without_a_sample_have_no_factor():
    with pytest.raises(ValueError, match="at least one sample"):
        scatter_factor(CountingTracer(), torch.zeros(1, 1, 2, 3, dtype=torch.int64))


@pytest.fixture
def folder(llvm, tmp_path, monkeypatch):
    """A clip of the installed scene `room`."""
    list_plugins, load_plugin = registry.list_plugins, registry.load_plugin
    monkeypatch.setattr(
        registry, "list_plugins", lambda g: ["room"] if g == "scenes" else list_plugins(g)
    )
    monkeypatch.setattr(
        registry, "load_plugin", lambda g, n: room if g == "scenes" else load_plugin(g, n)
    )
    return render_clip(Job("room", room(), PRESET, tmp_path / "room")) or tmp_path / "room"


def cell(folder, method):
    plan = RunPlan((method,), (StoredSource(folder),), (2.0,))
    (only,) = list_cells(plan)
    return ScatterMeter(CellLoader(plan)), only


def test_a_real_scene_has_a_factor_near_one(folder):
    """384 pixels: fixed costs of a launch and other load leave no more than the order."""
    meter, adaptive = cell(folder, "ours/by-rule")
    assert meter.has_scene(adaptive)
    measured = meter.measure(adaptive)
    assert measured.note == ""
    assert 0.1 < measured.factor < 10
    counts = torch.from_numpy(np.full((1, 1, 16, 24), 1))
    assert 0.2 < scatter_factor(open_wavefronts(folder), counts) < 5


def test_a_clip_without_its_scene_charges_samples_of_a_full_frame_and_says_why(tmp_path):
    meter, adaptive = cell(write_noise(tmp_path / "noise"), "ours/by-rule")
    assert not meter.has_scene(adaptive)
    measured = meter.measure(adaptive)
    assert measured.factor == FULL_FRAME.factor == 1.0
    assert measured.note.startswith("scattered samples cost as those of a full frame: ")
    assert "`rlbench render` did not write it" in measured.note
