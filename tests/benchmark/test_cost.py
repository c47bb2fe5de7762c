"""Costs of samples: published profiles, clip headers, and this machine's own tracer."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from rlbench.benchmark import cost
from rlbench.benchmark.cost import Cost, CostError
from rlbench.clips.stored import read_header
from rlbench.system import provenance


@pytest.mark.parametrize(
    ("scene", "published"),
    [("temple", 16.6), ("ripples", 17.6), ("city", 34.5), ("hall", 36.6), ("another", 26.3)],
)
def test_published_times_are_those_of_the_paper(scene, published):
    assert cost.profile("paper-2080ti").cost(scene, 720, 720).sample_ms == published


def test_published_times_are_scaled_by_pixels_as_their_convention_says():
    price = cost.profile("paper-2080ti").cost("temple", 360, 180)
    assert price.sample_ms == pytest.approx(16.6 / 8)
    assert price.convention.endswith("scaled by pixels from 720x720")


def test_a_scene_that_a_profile_does_not_name_has_a_note():
    price = cost.profile("paper-2080ti").cost("foyer", 720, 720)
    assert price.note == "the profile's default, as it has no 'foyer'"


@pytest.mark.parametrize("scene", ["city", "hall", "foyer"])
def test_costs_of_one_profile_share_a_convention(scene):
    published = cost.profile("paper-2080ti")
    assert published.cost(scene, 96, 96).convention == published.cost("temple", 9, 9).convention


def test_a_profile_may_be_a_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        'title = "t"\nsource = "s"\ndevice = "d"\nheight = 10\nwidth = 10\ndefault_ms = 3\n'
        "[scene_ms]\nfoyer = 5\n"
    )
    assert cost.profile(str(file)).cost("foyer", 10, 10) == Cost(
        5, "d, s, scaled by pixels from 10x10"
    )


@pytest.mark.parametrize("text", ["title = ", 'title = "t"', "colour = 3"])
def test_a_profile_that_cannot_be_read_is_an_error(tmp_path, text):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(CostError, match="bad.toml' cannot be read"):
        cost.profile(str(tmp_path / "bad.toml"))


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ('default_ms = "3"\n[scene_ms]', "default_ms"),
        ("default_ms = nan\n[scene_ms]", "default_ms"),
        ("default_ms = 3\nscene_ms = 4", "scene_ms"),
        ("default_ms = 3\n[scene_ms]\nfoyer = -5", "foyer"),
        ('default_ms = 3\n[scene_ms]\nfoyer = "5"', "foyer"),
    ],
)
def test_a_profile_with_impossible_values_is_an_error(tmp_path, line, key):
    text = 'title = "t"\nsource = "s"\ndevice = "d"\nheight = 10\nwidth = 10\n'
    (tmp_path / "bad.toml").write_text(text + line)
    with pytest.raises(CostError, match=f"bad.toml': {key} must be numbers"):
        cost.profile(str(tmp_path / "bad.toml"))


def test_an_unknown_profile_lists_those_that_exist():
    with pytest.raises(CostError, match="no cost profile 'x'. Use measured, paper-2080ti"):
        cost.profile("x")


def test_a_clip_rendered_here_costs_what_its_renderer_wrote(clip_folder):
    here = provenance.machine().name
    header = replace(read_header(clip_folder), device=here, sample_ms=7.5)
    assert cost.measured(header, here).sample_ms == 7.5


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
