"""Sanitised frames: methods read valid values, each repair is counted, and tests switch it off."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from rlbench import registry
from rlbench.checks.stress.bad_pixel import plant_in_buffer, plant_in_samples
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip
from rlbench.sampling import draw_samples
from rlbench.sanitize import read_unsanitized, sanitize_frame

INPUTS = frozenset({"albedo", "normal", "depth", "motion"})


def frame():
    return procedural_clip(3, Size(1, 8, 9), frames=1, pool_spp=4).frames[0]


def test_a_valid_frame_is_handed_over_without_copies_and_without_repairs():
    original = frame()
    gbuffer, pool, repairs, _ = sanitize_frame(original, INPUTS)
    assert all(gbuffer.buffers[name] is original.gbuffer.buffers[name] for name in INPUTS)
    counts, drawn = torch.full((1, 1, 8, 9), 2), original.pool.read
    assert torch.equal(pool.read(pool.empty(), counts), drawn(original.pool.empty(), counts))
    assert not repairs


def test_only_declared_buffers_are_read():
    bad = plant_in_buffer(frame(), "depth", math.nan, 3, 4)
    gbuffer, _, repairs, _ = sanitize_frame(bad, frozenset({"albedo"}))
    assert set(gbuffer.buffers) == {"albedo"}
    assert not repairs


def test_repairs_are_counted_by_pixel():
    bad = frame()
    for name, value in (("albedo", math.nan), ("depth", -1.0), ("motion", math.inf)):
        bad = plant_in_buffer(bad, name, value, 3, 4)
    bad = plant_in_buffer(bad, "depth", -1.0, 0, 0)
    gbuffer, _, repairs, _ = sanitize_frame(bad, INPUTS)
    assert repairs == {"albedo": 1, "depth": 2, "motion": 1}
    assert all(not buffer.isnan().any() for buffer in gbuffer.buffers.values())


def test_a_bad_sample_is_counted_once_it_is_drawn_though_two_passes_read_it():
    _, pool, repairs, _ = sanitize_frame(plant_in_samples(frame(), math.nan, 3, 4), INPUTS)
    samples = pool.empty()
    for spp, counted in ((0.0, {}), (1.0, {"radiance": 1}), (2.0, {"radiance": 1})):
        samples = draw_samples(pool, samples, torch.ones(1, 1, 8, 9), spp)
        assert repairs == counted


@pytest.mark.parametrize(("read", "is_finite"), [(sanitize_frame, True), (read_unsanitized, False)])
def test_a_run_is_sanitised_unless_a_test_switches_it_off(read, is_finite):
    clip = InMemoryClip("bad", "bad", "", (plant_in_samples(frame(), math.nan, 3, 4),))
    (result,) = run_clip(registry.load_method("mean"), clip, 1.0, read)
    assert bool(result.image.isfinite().all()) is is_finite
    assert dict(result.repairs) == ({"radiance": 1} if is_finite else {})


def test_a_buffer_named_after_another_has_its_rule():
    """albedo_first is an albedo."""
    bad = plant_in_buffer(frame(), "albedo", math.nan, 3, 4)
    gbuffer = replace(bad.gbuffer, buffers={"albedo_first": bad.gbuffer.albedo})
    valid = sanitize_frame(replace(bad, gbuffer=gbuffer), frozenset({"albedo_first"}))
    assert valid.gbuffer.extra("albedo_first").isfinite().all()
    assert valid.repairs == {"albedo_first": 1}
