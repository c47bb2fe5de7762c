"""Times of a run: sums that add up exactly, missing costs, and factors that clips share."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from rlbench import registry
from rlbench.benchmark import latency
from rlbench.benchmark import results as table
from rlbench.benchmark.cell_key import CellsError
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.clock import PARTS
from rlbench.benchmark.cost import Cost, Scatter
from rlbench.benchmark.cost_profile import ProfileTime
from rlbench.benchmark.latency import PartTime, Timing
from rlbench.benchmark.results import Row
from rlbench.benchmark.run_outcome import read_outcome
from rlbench.benchmark.run_plan import CellLoader, RunPlan, list_cells
from rlbench.benchmark.runner import RunSummary, measure
from rlbench.benchmark.timing import (
    ScatterMeter,
    TimingCache,
    drop_times,
    failed_time_rows,
    timing_rows,
)
from rlbench.parallel.executor import LOCAL, Resources
from rlbench.system import provenance
from tests.benchmark.test_runner import run_plan, scores, use_method_that_needs_a_file
from tests.conftest import write_noise, write_plugin
from tests.measuring import measure_scores

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


def test_the_columns_of_a_frame_add_up_exactly_and_what_describes_them_is_no_time():
    rows = by_metric()
    parts = [rows[f"{name}_ms"].value for name in ("plan", "allocate", "denoise")]
    assert rows["inference_ms"].value == sum(parts) == 5.5
    assert rows["sampling_ms"].value == 1.5 * 20
    assert rows["frame_ms"].value == 3 + 5.5 + 30
    assert rows["sample_fetch_ms"].convention.endswith("not part of frame_ms")
    others = {row.metric: row.value for row in rows.values() if row.unit != "ms"}
    found = [others[f"clock_{name}"] for name in ("rounds", "interval", "processor_share")]
    assert found == [4, 0.01, 1.9]
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


@pytest.mark.parametrize(
    ("clips", "on"),
    [
        (("imported", "traced"), ["imported", "traced"]),
        (("traced", "imported"), ["traced", "imported"]),
        (("first", "second"), ["first"]),  # clips that can be traced share one
    ],
)
def test_a_clip_without_its_scene_neither_takes_nor_gives_a_factor(tmp_path, measured, clips, on):
    expected = {clip: Scatter(1.7) for clip in clips} | {"imported": Scatter(1.0, NO_SCENE)}
    assert factors(tmp_path, clips) == {clip: expected[clip] for clip in clips}
    assert sorted(measured) == sorted(on)


def times_of(folder: Path, method: str) -> dict[str, float]:
    rows = table.read(folder)
    return dict(rows[rows["method"] == method].set_index("metric")["value"])


@pytest.mark.parametrize("method", ["mean", "eaw", "ours/by-rule"])
def test_the_parts_of_a_frame_add_up_exactly(tmp_path, method):
    folder = write_noise(
        tmp_path / "noise", sample_ms=2.0, gbuffer_ms=1.5, device=provenance.machine().name
    )
    measure(run_plan(folder, method, spp=(2.0,)), tmp_path / "r")
    times, traits = times_of(tmp_path / "r", method), registry.get_variant(method).traits
    parts = [times[f"{name}_ms"] for name in ("plan", "allocate", "denoise")]
    assert times["inference_ms"] == sum(parts)
    assert times["sampling_ms"] == 2 * 2.0
    assert times["gbuffer_ms"] == (1.5 if traits.inputs else 0)
    assert times["frame_ms"] == times["gbuffer_ms"] + sum(parts) + times["sampling_ms"]
    assert (times["allocate_ms"] > 0) == traits.adaptive
    assert times["clock_frames"] >= 9


def test_a_profile_charges_published_samples_and_inference(clip_folder, tmp_path):
    plan = run_plan(clip_folder, "mean", "eaw", "svgf", spp=(2.0,), cost="paper-2080ti")
    measure(plan, tmp_path / "r")
    share = (20 * 24) / (720 * 720)
    svgf = times_of(tmp_path / "r", "svgf")
    assert svgf["sample_ms"] == pytest.approx(26.3 * share)
    assert svgf["inference_ms"] == pytest.approx(3.9 * share)
    assert svgf["frame_ms"] == pytest.approx((3.9 + 2 * 26.3) * share)
    rows = table.read(tmp_path / "r")
    notes = rows[rows["metric"] == "frame_ms"].set_index("method")["note"]
    assert notes["svgf"] == notes["mean"] == ""
    assert "two devices: inference of" in notes["eaw"]
    assert notes["eaw"].endswith("samples of NVIDIA GeForce RTX 2080 Ti")


def test_only_cells_with_scores_are_timed_again(clip_folder, tmp_path):
    with pytest.raises(CellsError, match=r"no cell of this run is in .*Run without --times again"):
        measure(run_plan(clip_folder), tmp_path / "r", times="again")
    measure_scores(run_plan(clip_folder, spp=(1.0,)), tmp_path / "r")
    done = measure(run_plan(clip_folder, spp=(1.0, 2.0)), tmp_path / "r", times="again")
    assert (done, done.unscored) == (RunSummary(timed=1), 1)
    assert set(table.read(tmp_path / "r")["target_spp"]) == {1.0}


def test_a_cell_whose_timing_failed_keeps_its_scores_and_is_timed_by_the_next_run(
    clip_folder, tmp_path
):
    needed, plan = use_method_that_needs_a_file(tmp_path), run_plan(clip_folder, "odd")
    measure_scores(plan, tmp_path / "r")
    before = scores(tmp_path / "r")
    needed.unlink()
    for _ in range(2):
        done = measure(plan, tmp_path / "r")
        assert (done, [cell.method for cell in done.failures]) == (RunSummary(failed=1), ["odd"])
        outcome = read_outcome(plan, RunSummary(), tmp_path / "r")
        assert re.match("odd: no inference_ms on noise: FileNotFoundError: ", *outcome.missing)
    needed.touch()
    assert measure(plan, tmp_path / "r") == RunSummary(timed=1)
    assert measure(plan, tmp_path / "r") == RunSummary(cached=1)
    assert times_of(tmp_path / "r", "odd")["inference_ms"] > 0
    needed.unlink()
    assert measure(plan, tmp_path / "r", times="again") == RunSummary(failed=1)
    assert math.isnan(times_of(tmp_path / "r", "odd")["frame_ms"])
    assert scores(tmp_path / "r") == before


def test_all_missing_cells_are_timed_together_before_the_first_is_scored(clip_folder, tmp_path):
    seen = []
    measure(
        run_plan(clip_folder, "mean", "eaw"),
        tmp_path / "r",
        on_cell=lambda cell: seen.append(cell.method_name),
        on_timing=lambda done, total: seen.append((done, total)),
    )
    assert seen == [(0, 2), (1, 2), (2, 2), "mean", "eaw"]


def test_a_method_that_ends_the_program_does_not_spoil_the_times_of_others(clip_folder, tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", body="raise SystemExit(0)"))
    done = measure(run_plan(clip_folder, "odd", "mean"), tmp_path / "r")
    assert done == RunSummary(measured=1, failed=1)
    assert times_of(tmp_path / "r", "mean")["clock_rounds"] >= 3


@pytest.mark.parametrize(
    ("header", "options"),
    [({}, {"cost": "paper-2080ti"}), ({}, {"repeats": 3}), ({"sample_ms": 99.0}, {})],
)
def test_what_decides_times_alone_keeps_the_scores_of_a_cell(tmp_path, header, options):
    here = provenance.machine().name
    measure(run_plan(write_noise(tmp_path / "noise", device=here)), tmp_path / "r")
    before = scores(tmp_path / "r")
    folder = write_noise(tmp_path / "noise", device=here, **header)
    done = measure(run_plan(folder, **options), tmp_path / "r")
    assert (done, done.replaced) == (RunSummary(timed=1), 1)
    assert scores(tmp_path / "r") == before
    assert len(table.cells(tmp_path / "r")) == 1
    assert (times_of(tmp_path / "r", "mean")["sample_ms"] == 99.0) == bool(header)


def test_a_static_clip_is_timed_separately(tmp_path):
    log = tmp_path / "log"
    body = f"print(1, file=open({str(log)!r}, 'a')); return samples.mean, None"
    registry.use_plugin(write_plugin(tmp_path / "odd.py", "odd", body=body))
    frames = []
    for name, second in (("one", {}), ("two", {"static": True}), ("short", {"frames": 1})):
        log.unlink(missing_ok=True)
        clips = [write_noise(tmp_path / name / "a"), write_noise(tmp_path / name / "b", **second)]
        measure(
            RunPlan(("odd",), tuple(map(StoredSource, clips)), (1.0,), repeats=5), tmp_path / name
        )
        frames.append(len(log.read_text().splitlines()))
    # 3, 3 and 1 frames are scored; each row is timed in rounds of 4 frames
    assert [count % 4 for count in frames] == [2 * 3 % 4, 2 * 3 % 4, (3 + 1) % 4]
