"""Remeasured times per sample."""

from dataclasses import replace

import pytest

from rlbench import registry
from rlbench.clips.stored import ClipError, read_header, write_header
from rlbench.render.jobs.job import Job
from rlbench.render.jobs.render_clips import remeasure_sample_ms, render_clip
from rlbench.render.presets import Preset
from tests.render.small_scenes import room

PRESET = Preset("test", "tests", (16, 24), 4, 2, pool_spp=2)


@pytest.fixture
def folder(llvm, tmp_path, monkeypatch):
    """A clip of the installed scene `room`."""
    monkeypatch.setattr(registry, "list_plugins", lambda group: ["room"])
    monkeypatch.setattr(registry, "load_plugin", lambda group, name: room)
    render_clip(Job("room", room(), PRESET, tmp_path / "room"))
    return tmp_path / "room"


def test_remeasuring_changes_the_times_per_sample_and_nothing_else(folder):
    before = read_header(folder)
    slow = replace(before, sample_ms=1e6, pools=("path", "restir"), pools_ms=(1e6, 3e6))
    write_header(folder, slow)
    now = remeasure_sample_ms(folder)
    assert now == read_header(folder)
    assert 0 < now.sample_ms < 1e5  # 384 pixels: a millisecond or two
    assert now.pools_ms == pytest.approx((now.sample_ms, 3 * now.sample_ms))
    assert 0 < now.sample_p5_ms <= now.sample_ms <= now.sample_p95_ms
    assert now.gbuffer_ms > 0
    assert now.timed_with.endswith(" threads")
    times = {
        name: getattr(slow, name)
        for name in ("sample_ms", "pools_ms", "sample_p5_ms", "sample_p95_ms", "gbuffer_ms")
    }
    assert replace(now, **times) == slow
    write_header(folder, before)


def test_a_clip_of_another_machine_is_not_remeasured(folder):
    before = read_header(folder)
    write_header(folder, replace(before, device="abacus"))
    with pytest.raises(ClipError, match="was rendered on 'abacus'.*times samples on this machine"):
        remeasure_sample_ms(folder)
    write_header(folder, before)
