"""Factors of scattered samples: shared by clips that can be traced, and by no others."""

from __future__ import annotations

import pytest
import torch

from rlbench.benchmark import latency
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.cost import Scatter
from rlbench.benchmark.run_plan import CellLoader, RunPlan, list_cells
from rlbench.benchmark.timing import ScatterMeter, TimingCache
from rlbench.parallel.executor import LOCAL, Resources
from tests.conftest import write_noise

NOTE = "its scene is not here"


@pytest.fixture
def measured(monkeypatch) -> list[str]:
    """The clips on which a factor is measured; clips named `imported` have no scene."""
    clips: list[str] = []
    monkeypatch.setattr(latency, "time_methods", lambda rows, *_, **__: [None] * len(rows))

    def measure(meter, cell):
        clips.append(cell.header.name)
        return Scatter(1.0, NOTE) if cell.header.name == "imported" else Scatter(1.7)

    monkeypatch.setattr(ScatterMeter, "measure", measure)
    monkeypatch.setattr(
        ScatterMeter, "has_scene", lambda meter, cell: cell.header.name != "imported"
    )
    return clips


def factors(tmp_path, clips) -> dict[str, Scatter]:
    sources = tuple(StoredSource(write_noise(tmp_path / name, frames=1)) for name in clips)
    plan = RunPlan(("accumulate/contrast",), sources, (1.0,), repeats=2, seeds=(0, 1))
    cells, times = list_cells(plan), TimingCache(CellLoader(plan), None)
    times.measure_all(cells, LOCAL, Resources(torch.get_num_threads(), 0), lambda *_: None)
    return {cell.header.name: times.cost(cell).scatter for cell in cells}


@pytest.mark.parametrize("clips", [("imported", "traced"), ("traced", "imported")])
def test_a_clip_without_its_scene_neither_takes_nor_gives_a_factor(tmp_path, measured, clips):
    assert factors(tmp_path, clips) == {"imported": Scatter(1.0, NOTE), "traced": Scatter(1.7)}
    assert sorted(measured) == ["imported", "traced"]


def test_clips_that_can_be_traced_share_one_factor(tmp_path, measured):
    assert set(factors(tmp_path, ("first", "second")).values()) == {Scatter(1.7)}
    assert measured == ["first"]
