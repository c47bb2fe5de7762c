"""Times of a run: sums that add up exactly, missing costs, and factors that clips share."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from rlbench.benchmark import latency
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.clock import PARTS
from rlbench.benchmark.cost import Cost, Scatter
from rlbench.benchmark.cost_profile import ProfileTime
from rlbench.benchmark.latency import PartTime, Timing
from rlbench.benchmark.results import Row
from rlbench.benchmark.run_plan import CellLoader, RunPlan, list_cells
from rlbench.benchmark.timing import (
    ScatterMeter,
    TimingCache,
    drop_times,
    failed_time_rows,
    timing_rows,
)
from rlbench.parallel.executor import LOCAL, Resources
from tests.conftest import write_noise

CPU = "EPYC, 2 threads"

TEMPLATE = Row("r", "mean", "noise", "noise", 2.0, 1.5, -1, "", math.nan, device=CPU)

TIMING = Timing(
    clip="noise",
    plan=PartTime(1.0, 1.1, 2.0),
    allocate=PartTime(0.5, 0.6, 0.7),
    denoise=PartTime(4.0, 4.4, 8.0),
    inference=PartTime(5.5, 6.0, 10.0),
    sample_fetch=PartTime(100.0, 100.0, 200.0),
    low=5.0,
    high=6.0,
    frames_used="middle half",
    frames=12,
    rounds=4,
    half_width=0.01,
    processor_share=1.9,
    calibration_ratio=1.02,
    switches=0.5,
    load_average=1.0,
    threads=2,
)

COST = Cost(20.0, "a profile", device="EPYC, 2 cores", gbuffer_ms=3.0, gbuffer_convention="traced")


def by_metric(timing=TIMING, cost=COST, published=None):
    return {row.metric: row for row in timing_rows(TEMPLATE, timing, cost, published)}


def test_the_columns_of_a_frame_add_up_exactly():
    rows = by_metric()
    parts = [rows[f"{name}_ms"].value for name in ("plan", "allocate", "denoise")]
    assert rows["inference_ms"].value == sum(parts) == 5.5
    assert rows["sampling_ms"].value == 1.5 * 20
    assert rows["frame_ms"].value == 3 + 5.5 + 30
    assert rows["sample_fetch_ms"].convention.endswith("not part of frame_ms")


def test_times_are_in_milliseconds_and_what_describes_them_is_not():
    rows = by_metric()
    times = [row for row in rows.values() if row.unit == "ms"]
    assert {row.direction for row in times} == {"lower"}
    others = {row.metric: row.value for row in rows.values() if row.unit != "ms"}
    assert others["clock_rounds"] == 4
    assert others["clock_interval"] == 0.01
    assert others["clock_processor_share"] == 1.9
    assert all(name.startswith("clock_") for name in others)


def test_scattered_samples_cost_their_factor():
    rows = by_metric(cost=replace(COST, scatter=Scatter(1.1)))
    assert rows["sampling_ms"].value == pytest.approx(1.1 * 30)
    assert rows["frame_ms"].value == pytest.approx(3 + 5.5 + 33)
    assert rows["sampling_ms"].convention.endswith("x 1.1 for scattered samples")
    noted = by_metric(cost=replace(COST, scatter=Scatter(1.0, "no scene")))
    assert (noted["sampling_ms"].value, noted["sampling_ms"].note) == (30, "no scene")


def test_a_sample_without_a_cost_leaves_its_reason_in_every_sum():
    rows = by_metric(cost=Cost(math.nan, "a profile", "no such pool")).values()
    unknown = {row.metric: row.note for row in rows if math.isnan(row.value)}
    assert unknown == dict.fromkeys(("sample_ms", "sampling_ms", "frame_ms"), "no such pool")


def test_every_part_has_an_interval_and_those_of_a_frame_add_up():
    rows = by_metric(cost=replace(COST, interval=(0.9, 1.2)))
    ends = {
        name: (rows[f"{name}_low_ms"].value, rows[f"{name}_high_ms"].value)
        for name in (*PARTS, "inference", "gbuffer", "sample", "sampling", "frame")
    }
    assert ends["inference"] == pytest.approx((5.0, 6.0))
    assert ends["denoise"] == pytest.approx((4 * 5 / 5.5, 4 * 6 / 5.5))
    assert ends["sample"] == pytest.approx((18.0, 24.0))
    assert ends["frame"] == pytest.approx((5 + 0.9 * 33, 6 + 1.2 * 33))
    for index in (0, 1):
        parts = sum(ends[name][index] for name in PARTS)
        assert parts == pytest.approx(ends["inference"][index])


def test_an_uncertain_part_names_its_reason_and_the_frame_only_if_it_is_uncertain_too():
    """0.5 of 5.5 ms is much of inference, and little of a frame of 38.5 ms."""
    rows = by_metric(replace(TIMING, low=3.0, disturbance="busy"))
    noted = {row.metric for row in rows.values() if row.note == "uncertain: busy"}
    assert {"plan_ms", "allocate_ms", "denoise_ms", "inference_ms"} <= noted
    assert not noted & {"sample_ms", "sampling_ms", "gbuffer_ms", "sample_fetch_ms", "frame_ms"}
    wide = by_metric(replace(TIMING, high=50.0, disturbance="busy"))
    assert wide["frame_ms"].note == "uncertain: busy"


def test_an_uncertain_sample_makes_the_frame_uncertain_and_not_the_inference():
    note = "uncertain: a sample took 2 to 40 ms"
    rows = by_metric(cost=replace(COST, note=note, interval=(0.1, 2.0)))
    noted = {row.metric for row in rows.values() if row.note.startswith("uncertain:")}
    assert noted == {"sample_ms", "sampling_ms", "frame_ms"}


@pytest.mark.parametrize(
    ("device", "sampler", "mixed"),
    [
        (CPU, "EPYC, 2 cores", False),
        (CPU, "Xeon, 2 cores", True),
        ("NVIDIA H200", "EPYC, 2 cores", True),
        ("NVIDIA H200", "NVIDIA H200", False),
        ("NVIDIA H200", "NVIDIA GeForce RTX 2080 Ti", True),
        (CPU, "", False),  # not known
    ],
)
def test_a_frame_of_two_devices_names_them(device, sampler, mixed):
    template = replace(TEMPLATE, device=device)
    rows = timing_rows(template, TIMING, replace(COST, device=sampler))
    (note,) = [row.note for row in rows if row.metric == "frame_ms"]
    expected = f"two devices: inference of {device}, samples of {sampler}"
    assert note == (expected if mixed else "")


def test_a_published_inference_time_replaces_the_measured_one_and_still_adds_up():
    paper = ProfileTime(22.0, "RTX, a paper, scaled by pixels from 720x720")
    rows = by_metric(cost=replace(COST, device="RTX"), published=paper)
    assert rows["inference_ms"].value == pytest.approx(22.0)
    assert rows["plan_ms"].value == pytest.approx(22.0 * 1.0 / 5.5)
    assert rows["frame_ms"].value == pytest.approx(3 + 22 + 30)
    assert rows["frame_ms"].note == ""  # one device
    assert "split into parts as measured on EPYC" in rows["plan_ms"].convention
    assert rows["inference_p50_ms"].value == 6.0


def test_times_are_told_from_scores():
    score = replace(TEMPLATE, metric="psnr", value=20.0, unit="dB")
    rows = [score, *timing_rows(TEMPLATE, TIMING, COST), *failed_time_rows(TEMPLATE, "no luck")]
    assert drop_times(rows) == [score]
    assert {row.note for row in failed_time_rows(TEMPLATE, "no luck")} == {"no luck"}


NO_SCENE = "its scene is not here"


@pytest.fixture
def measured(monkeypatch) -> list[str]:
    """The clips on which a factor is measured; clips named `imported` have no scene."""
    clips: list[str] = []
    monkeypatch.setattr(latency, "time_methods", lambda rows, *_, **__: [None] * len(rows))

    def measure(meter, cell):
        clips.append(cell.header.name)
        return Scatter(1.0, NO_SCENE) if cell.header.name == "imported" else Scatter(1.7)

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
    assert factors(tmp_path, clips) == {"imported": Scatter(1.0, NO_SCENE), "traced": Scatter(1.7)}
    assert sorted(measured) == ["imported", "traced"]


def test_clips_that_can_be_traced_share_one_factor(tmp_path, measured):
    assert set(factors(tmp_path, ("first", "second")).values()) == {Scatter(1.7)}
    assert measured == ["first"]
