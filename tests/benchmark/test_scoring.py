"""Rows from images: missing values, and images that are not scored."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from metrics.metric import Metric
from rlbench import registry
from rlbench.benchmark.results import COUNT_PREFIX, NOISE_CEILING, Row
from rlbench.benchmark.scoring import (
    add_counts,
    compare_frame,
    count_rows,
    make_ground_truth,
    refusal_row,
    score_frame,
)
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.clips.stored import read_header
from rlbench.frames import Size
from rlbench.run import run_clip

TEMPLATE = Row("r", "mean", "noise", "noise", 2.0, 1.5, -1, "", math.nan)


BRIGHT = Metric(
    "bright", "", "higher", "mean of all channels", lambda c: c.image.flatten(1).mean(1)
)
MOVED = Metric(
    "moved", "", "", "mean motion", lambda c: c.motion.mean((1, 2, 3)), needs=("motion",)
)


def score(metric, result, header, previous=None):
    return list(score_frame(TEMPLATE, [metric], compared(result, previous), result, header))


def compared(result, previous=None):
    truth = make_ground_truth(Metric, result.frame)
    return compare_frame(Metric, result, truth, previous and compared(previous))


@pytest.fixture
def frames():
    method = registry.load_method("mean")
    return list(run_clip(method, procedural_clip(3, Size(1, 16, 16), 2, 4), 2.0))


def test_a_score_has_the_samples_of_its_frame(frames, clip_folder):
    header = read_header(clip_folder)
    (row,) = score(BRIGHT, frames[1], header, frames[0])
    assert row.value == float(frames[1].image.mean())
    assert (row.frame, row.mean_spp, row.direction) == (1, 2.0, "higher")


def test_a_temporal_metric_has_no_score_of_the_first_frame(frames, clip_folder):
    metric, header = replace(BRIGHT, previous_frames=1), read_header(clip_folder)
    assert score(metric, frames[0], header) == []
    assert len(score(metric, frames[1], header, frames[0])) == 1


def test_a_metric_is_handed_the_counts_and_valid_motion_of_the_frame(frames):
    comparison = compared(frames[1])
    assert comparison.counts is frames[1].samples.counts
    assert comparison.motion.shape == (1, 2, 16, 16)
    assert comparison.motion.isfinite().all()


def test_a_metric_without_the_motion_that_it_needs_has_a_reason_and_no_score(frames, clip_folder):
    gbuffer = frames[1].frame.gbuffer.select(frozenset())
    result = replace(frames[1], frame=replace(frames[1].frame, gbuffer=gbuffer))
    (row,) = score(MOVED, result, read_header(clip_folder))
    assert math.isnan(row.value)
    assert row.note == "the clip has no motion, which the metric reads"


def test_each_frame_has_the_noise_ceiling_of_the_clips_header(frames, clip_folder):
    header = replace(read_header(clip_folder), noise_ceiling_db=(30.5, 31.5, 32.5))
    rows = [row for result in frames for row in score(BRIGHT, result, header)]
    ceilings = [row for row in rows if row.metric == NOISE_CEILING]
    assert [(row.frame, row.value, row.unit) for row in ceilings] == [
        (0, 30.5, "dB"),
        (1, 31.5, "dB"),
    ]


def test_an_infinite_score_is_nan_with_a_note(frames, clip_folder):
    result = replace(frames[0], image=torch.full_like(frames[0].image, torch.inf))
    (row,) = score(BRIGHT, result, read_header(clip_folder))
    assert math.isnan(row.value)
    assert row.note == "the value is inf"


def test_a_skipped_cell_has_a_reason_and_no_value():
    row = refusal_row(TEMPLATE, "needs CUDA")
    assert (row.metric, math.isnan(row.value), row.note) == ("psnr", True, "needs CUDA")


def test_repaired_pixels_are_counted_in_a_row(frames, clip_folder):
    result = replace(frames[1], repairs={"depth": 2, "radiance": 1})
    *_, row = score(BRIGHT, result, read_header(clip_folder), frames[0])
    assert (row.metric, row.value) == ("repaired", 3.0)
    assert row.convention.endswith("depth 2, radiance 1")


def test_an_event_of_the_header_is_a_row_of_its_frame(frames, clip_folder):
    header = replace(read_header(clip_folder), cuts=(1,), light_changes=(1,))
    assert [row.metric for row in score(BRIGHT, frames[0], header)] == ["bright"]
    _, *events = score(BRIGHT, frames[1], header)
    assert [(row.metric, row.frame, row.value) for row in events] == [
        ("event_cut", 1, 1.0),
        ("event_light", 1, 1.0),
    ]


def test_a_metric_without_enough_previous_frames_has_no_row(frames, clip_folder):
    metric, header = replace(BRIGHT, previous_frames=2), read_header(clip_folder)
    assert score(metric, frames[1], header, frames[0]) == []


@pytest.mark.parametrize("most", [5, 8, 12])  # less than the cap, the cap, and more
def test_counts_that_are_added_frame_by_frame_are_those_of_the_whole_clip(most):
    random = torch.Generator().manual_seed(most)
    counts = [torch.randint(most + 1, (1, 1, 19, 23), generator=random) for _ in range(7)]
    pixels = torch.zeros(8 + 1, dtype=torch.long)
    for each in counts:
        pixels = add_counts(pixels, each)
    drawn = torch.cat([each.flatten() for each in counts])
    histogram = torch.bincount(drawn, minlength=8 + 1).tolist()
    rows = count_rows(TEMPLATE, pixels)
    assert [row.metric for row in rows] == [f"{COUNT_PREFIX}{n}" for n in range(max(most, 8) + 1)]
    assert [row.value for row in rows] == [100 * count / len(drawn) for count in histogram]
    assert {row.mean_spp for row in rows} == {float(drawn.double().mean())}
