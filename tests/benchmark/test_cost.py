"""Costs of samples: published profiles, clip headers, and this machine's own tracer."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from reports.published import published as published_numbers
from rlbench.benchmark import cost
from rlbench.benchmark.cost_profile import CostError, read_profile
from rlbench.clips.header import read_header
from rlbench.system import provenance

DEVICE = 'title = "t"\nsource = "s"\ndevice = "d"\nheight = 10\nwidth = 10\n'


@pytest.fixture
def read(tmp_path):
    """Reads a profile with a text."""

    def read(text):
        (tmp_path / "mine.toml").write_text(text)
        return read_profile(str(tmp_path / "mine.toml"))

    return read


def test_published_times_are_scaled_by_pixels_as_their_convention_says():
    price = read_profile("paper-2080ti").sample("temple", 360, 180)
    assert price.ms == pytest.approx(16.6 / 8)
    assert price.convention.endswith("scaled by pixels from 720x720")
    other = read_profile("paper-2080ti").sample("foyer", 720, 720)
    assert other.note == "the profile's default, as it has no 'foyer'"


def test_a_profile_may_be_a_file(read):
    profile = read(f"{DEVICE}default_ms = 3\n[scene_ms]\nfoyer = 5\n")
    assert profile.sample("foyer", 10, 10) == (5, "d, s, scaled by pixels from 10x10", "")
    assert profile.inference("ours", 10, 10) is None
    for size in ((360, 640), (720, 1280)):  # one time is of the size of the clip
        assert read("default_ms = 4.2\n").sample("city", *size).ms == 4.2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f'{DEVICE}default_ms = "3"', "default_ms must be numbers"),
        (f"{DEVICE}default_ms = nan", "default_ms must be numbers"),
        (f"{DEVICE}default_ms = 3\nscene_ms = 4", "scene_ms must be numbers"),
        (f"{DEVICE}default_ms = 3\n[scene_ms]\nfoyer = -5", "foyer must be numbers"),
        (f"{DEVICE}default_ms = 3\ninference_ms = 4", "inference_ms must be numbers"),
        (f"{DEVICE}default_ms = 3\n[inference_ms.720x720]\nours = -1", "ours must be numbers"),
        (f"{DEVICE}default_ms = 3\n[inference_ms.large]\nours = 1", "inference_ms.large must"),
        (f"{DEVICE}default_ms = 3\n[inference_ms]\nours = 1", "inference_ms.ours must"),
        ("default_ms = 4.2\n[inference_ms.720x720]\nours = 3.0\n", "missing: height, width"),
    ],
)
def test_a_profile_with_impossible_values_is_an_error(read, text, words):
    with pytest.raises(CostError, match=f"mine.toml'.*: {re.escape(words)}"):
        read(text)


def test_an_unknown_profile_lists_those_that_exist():
    with pytest.raises(CostError, match="no cost profile 'x'. Use measured, paper-2080ti"):
        read_profile("x")


@pytest.mark.parametrize("row", published_numbers().table, ids=lambda row: row.row)
def test_published_inference_times_are_those_of_the_papers_table(row):
    assert read_profile("paper-2080ti").inference(row.row, 720, 720).ms == row.inference_ms


def test_inference_times_are_scaled_from_the_nearest_size(read):
    profile = read(
        f"{DEVICE}default_ms = 3\n[inference_ms.100x100]\nours = 8\nsvgf = 4\n"
        "[inference_ms.1000x1000]\nours = 300\n"
    )
    assert profile.inference("ours", 100, 200).ms == 16
    assert profile.inference("ours", 1000, 500).ms == 150
    assert profile.inference("svgf", 1000, 1000).ms == 400
    assert profile.inference("ours", 1000, 500).convention.endswith("pixels from 1000x1000")
    assert profile.inference("oidn", 100, 100) is None


def here(clip_folder, **fields):
    machine = provenance.machine().name
    header = replace(read_header(clip_folder), device=machine, sample_ms=8.0, **fields)
    return header, machine


def test_a_time_of_a_sample_that_varied_much_has_a_wide_interval(clip_folder):
    times = {"sample_p5_ms": 7.0, "timed_with": "llvm_ad_rgb, 3 threads"}
    header, machine = here(clip_folder, sample_p95_ms=31.0, **times)
    price = cost.measured(header, machine)
    assert price.note == "uncertain: a sample took 7 to 31 ms when the clip was rendered"
    assert (price.sample_ms, price.interval) == (8.0, (7 / 8, 31 / 8))
    assert price.convention == f"path tracer, measured on {machine}, llvm_ad_rgb, 3 threads"
    steady, _ = here(clip_folder, sample_p95_ms=8.5, **times)
    assert cost.measured(steady, machine).note == ""


def test_a_g_buffer_costs_what_the_clips_renderer_found_relative_to_a_sample(clip_folder):
    header, machine = here(clip_folder, gbuffer_ms=6.0)
    path = cost.measured(header, machine)
    assert cost.with_gbuffer(path, path.sample_ms, header).gbuffer_ms == 6.0
    unknown = cost.with_gbuffer(path, path.sample_ms, replace(header, gbuffer_ms=0.0))
    assert unknown.gbuffer_ms == 0
    assert unknown.gbuffer_convention.startswith("not known, charged as 0")
    profile = read_profile("paper-2080ti")
    city = replace(header, scene="city", height=720, width=720)
    path = cost.published(profile, city, "path")
    assert cost.with_gbuffer(path, path.sample_ms, city).gbuffer_ms == pytest.approx(34.5 * 6 / 8)


def test_a_scene_that_cannot_be_traced_here_has_no_cost_and_a_reason(clip_folder):
    price = cost.measured(read_header(clip_folder), provenance.machine().name)
    assert math.isnan(price.sample_ms)
    assert "rendered on 'another machine', not here" in price.note
    assert "'noise' is not a scene" in price.note


@pytest.mark.slow
def test_a_scene_rendered_elsewhere_is_traced_here_once(clip_folder, tmp_path):
    header = replace(read_header(clip_folder), scene="temple")
    first = cost.measured(header, "here")
    assert first.sample_ms > 0
    assert cost.measured(header, "here") == first
    file = Path(tmp_path / "cache" / "sample_ms.json")
    ((key, _),) = json.loads(file.read_text()).items()
    file.write_text(json.dumps({key.rpartition(" ")[0] + " other-code": 1e9}))
    assert cost.measured(header, "here").sample_ms < 1e6  # of other code, so traced anew
