"""Presets."""

from pathlib import Path

import pytest

from rlbench.render.jobs.job import Job
from rlbench.render.presets import PRESETS, get_preset
from tests.render.small_scenes import room


def content_key(preset):
    return Job("room", room(), preset, Path("a")).content_key


def test_mini_has_main_takes_only_and_standard_has_all():
    takes = {name: PRESETS[name].takes for name in ("mini", "standard", "paper")}
    assert takes == {"mini": "main", "standard": "all", "paper": "main"}


def test_a_preset_with_extra_buffers_has_another_name_and_content_key():
    more = PRESETS["mini"].with_buffers(["object"])
    assert more.name == "mini-views"
    assert content_key(more) != content_key(PRESETS["mini"])


def test_an_unknown_buffer_is_an_error_that_lists_the_available_ones():
    with pytest.raises(ValueError, match="no G-buffer channel emission to add; available: object"):
        PRESETS["mini"].with_buffers(["object", "emission"])


def test_an_unknown_preset_is_an_error_that_lists_the_available_ones():
    with pytest.raises(LookupError, match="mini"):
        get_preset("huge")


def test_the_papers_protocol():
    paper = PRESETS["paper"]
    assert (paper.size, paper.frames, paper.pool_spp) == ((720, 720), 20, 8)
    assert 2 * paper.reference_spp == 1000
    assert paper.paths_per_frame == 720 * 720 * 1008


def test_a_preset_with_a_radiance_cap_has_another_name_and_content_key():
    capped = PRESETS["mini"].with_radiance_cap(64.0)
    assert capped.name == "mini-cap64"
    assert content_key(capped) != content_key(PRESETS["mini"])


@pytest.mark.parametrize("cap", [0.0, -1.0, float("nan")])
def test_a_cap_of_zero_or_less_is_an_error(cap):
    with pytest.raises(ValueError, match="must be above 0"):
        PRESETS["mini"].with_radiance_cap(cap)
