"""Rows from images: missing values, images that are not scored, ground truth that cells share."""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass, replace

import pytest
import torch

from metrics.metric import Metric
from rlbench import registry
from rlbench.benchmark import results, scoring
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.results import COUNT_PREFIX, NOISE_CEILING, Row
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.scoring import (
    GroundTruthCache,
    add_counts,
    compare_frame,
    count_rows,
    make_ground_truth,
    score_frame,
)
from rlbench.clips.header import read_header
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.clips.procedural.folder import write_procedural_clip
from rlbench.family import Traits
from rlbench.frames import Reference, Size
from rlbench.run import run_clip
from tests.benchmark.fake_machine import Machine, Worker
from tests.measuring import measure_scores

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
    assert score(replace(BRIGHT, previous_frames=1), frames[0], header) == []


def test_a_score_without_motion_or_of_infinity_is_a_reason_and_no_number(frames, clip_folder):
    gbuffer = frames[1].frame.gbuffer.select(frozenset())
    result = replace(frames[1], frame=replace(frames[1].frame, gbuffer=gbuffer))
    (row,) = score(MOVED, result, read_header(clip_folder))
    assert math.isnan(row.value)
    assert row.note == "the clip has no motion, which the metric reads"
    infinite = replace(frames[0], image=torch.full_like(frames[0].image, torch.inf))
    (row,) = score(BRIGHT, infinite, read_header(clip_folder))
    assert (math.isnan(row.value), row.note) == (True, "the value is inf")


@pytest.mark.parametrize(("light", "note"), [(0.0, scoring.BLACK), (1e-5, scoring.BLACK), (1, "")])
def test_a_score_against_a_black_reference_says_so(frames, clip_folder, light, note):
    result = frames[0]
    black = result.frame.reference.mean * light
    result = replace(result, frame=replace(result.frame, reference=Reference(black, black)))
    psnr = registry.load_or_explain("metrics", "psnr")
    (row,) = score(psnr, result, read_header(clip_folder))
    assert row.note == note


def test_repaired_pixels_are_counted_in_a_row(frames, clip_folder):
    result = replace(frames[1], repairs={"depth": 2, "radiance": 1})
    *_, row = score(BRIGHT, result, read_header(clip_folder), frames[0])
    assert (row.metric, row.value) == ("repaired", 3.0)
    assert row.convention.endswith("depth 2, radiance 1")


def test_events_and_noise_ceilings_of_the_header_are_rows_of_their_frames(frames, clip_folder):
    events = {"cuts": (1,), "light_changes": (1,), "noise_ceiling_db": (30.5, 31.5, 32.5)}
    header = replace(read_header(clip_folder), **events)
    rows = [row for result in frames for row in score(BRIGHT, result, header)]
    found = [(row.metric, row.frame, row.value) for row in rows if row.metric != "bright"]
    ceilings = [(NOISE_CEILING, 0, 30.5), (NOISE_CEILING, 1, 31.5)]
    assert sorted(found) == sorted([*ceilings, ("event_cut", 1, 1.0), ("event_light", 1, 1.0)])


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


@pytest.fixture
def clip():
    return procedural_clip(3, Size(1, 16, 16), 3, 4)


def read(cache, clip):
    opened = cache.open(clip)
    return [opened.ground_truth(frame) for frame in opened]


def test_every_cell_of_a_clip_gets_the_same_ground_truth_and_another_clip_its_own(clip):
    cache, other = GroundTruthCache(Metric), procedural_clip(4, Size(1, 16, 16), 3, 4)
    reopened = InMemoryClip(clip.name, clip.scene, clip.digest, list(clip))
    first, second = read(cache, clip), read(cache, reopened)
    assert [a is b for a, b in zip(first, second, strict=True)] == [True] * 3
    assert (first[1].motion == make_ground_truth(Metric, list(clip)[1]).motion).all()
    for truth, frame in zip(read(cache, other), other, strict=True):
        assert (truth.half_a == frame.reference.half_a).all()


def test_of_a_large_clip_one_frame_is_kept(clip, monkeypatch):
    monkeypatch.setattr(scoring, "MAX_PIXELS", 3 * 16 * 16 - 1)
    opened = GroundTruthCache(Metric).open(clip)
    frames = list(opened)
    assert (opened.ground_truth(frames[2]).half_a == frames[2].reference.half_a).all()
    with pytest.raises(KeyError):
        opened.ground_truth(frames[1])


def test_a_copy_for_another_process_is_empty(clip):
    cache = GroundTruthCache(Metric)
    read(cache, clip)
    assert len(pickle.dumps(cache)) < 1000


@dataclass(frozen=True)
class Vandal(Worker):
    """Writes to the motion that it receives."""

    def plan(self, gbuffer, samples, state):
        gbuffer.motion.add_(3.0)
        return super().plan(gbuffer, samples, state)


def test_a_method_that_writes_to_its_inputs_changes_no_ground_truth(clip):
    cache = GroundTruthCache(Metric)
    vandal = Vandal(Machine(), traits=Traits(inputs=frozenset({"motion"})))
    expected = [frame.gbuffer.motion.clone() for frame in clip]
    for _ in run_clip(vandal, cache.open(clip), 1.0):
        pass
    assert expected[1].abs().sum() > 0
    for truth, motion in zip(read(cache, clip), expected, strict=True):
        assert (truth.motion == motion).all()


def values_of(methods, clips, spp, folder):
    measure_scores(RunPlan(methods, clips, spp, repeats=1), folder)
    rows = results.read(folder)
    rows = rows[~rows["metric"].str.startswith("count")]
    return rows.set_index(["method", "clip", "target_spp", "metric", "frame"])["value"]


def test_scores_beside_other_rows_clips_and_budgets_are_those_of_a_row_alone(tmp_path):
    clips = [StoredSource(write_procedural_clip(tmp_path / str(i), i, 32, 3)) for i in (3, 4)]
    together = values_of(("mean", "eaw"), tuple(clips), (8.0, 1.0), tmp_path / "together")
    alone = values_of(("eaw",), (clips[1],), (1.0,), tmp_path / "alone")
    assert len(alone) > 25
    assert together[alone.index].equals(alone)
