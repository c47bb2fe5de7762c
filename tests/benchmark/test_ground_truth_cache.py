"""What metrics derive from a reference is made once for all cells of a clip, and never mixed up."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import pytest
import torch

from metrics.metric import Metric
from rlbench.benchmark import results, scoring
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.runner import measure
from rlbench.benchmark.scoring import GroundTruthCache, make_ground_truth
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.clips.procedural.folder import write_procedural_clip
from rlbench.family import Traits
from rlbench.frames import Size
from rlbench.run import run_clip


@pytest.fixture
def clip():
    return procedural_clip(3, Size(1, 16, 16), 3, 4)


def read(cache, clip):
    opened = cache.open(clip)
    return [opened.ground_truth(frame) for frame in opened]


def test_every_cell_of_a_clip_gets_the_same_ground_truth(clip):
    cache = GroundTruthCache(Metric)
    reopened = InMemoryClip(clip.name, clip.scene, clip.digest, list(clip))
    first, second = read(cache, clip), read(cache, reopened)
    assert [a is b for a, b in zip(first, second, strict=True)] == [True] * 3
    assert (first[1].motion == make_ground_truth(Metric, list(clip)[1]).motion).all()


def test_another_clip_has_its_own_ground_truth(clip):
    cache, other = GroundTruthCache(Metric), procedural_clip(4, Size(1, 16, 16), 3, 4)
    for each in (clip, other, clip):
        opened = cache.open(each)
        for frame in opened:
            assert (opened.ground_truth(frame).half_a == frame.reference.half_a).all()


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
class Vandal:
    """Writes to the motion that it receives."""

    traits: Traits = Traits(inputs=frozenset({"motion"}))

    def start(self, size):
        return None

    def plan(self, gbuffer, samples, state):
        gbuffer.motion.add_(3.0)
        return torch.ones_like(samples.mean[:, :1])

    def denoise(self, gbuffer, samples, state):
        return samples.mean, None


def test_a_method_that_writes_to_its_inputs_changes_no_ground_truth(clip):
    cache = GroundTruthCache(Metric)
    expected = [frame.gbuffer.motion.clone() for frame in clip]
    for _ in run_clip(Vandal(), cache.open(clip), 1.0):
        pass
    assert expected[1].abs().sum() > 0
    for truth, motion in zip(read(cache, clip), expected, strict=True):
        assert (truth.motion == motion).all()


def scores(methods, clips, folder):
    plan = RunPlan(methods, clips, (1.0, 2.0), repeats=1)
    measure(plan, folder, scores_only=True)
    rows = results.read(folder)
    rows = rows[~rows["metric"].str.startswith("count")]
    return rows.set_index(["method", "clip", "target_spp", "metric", "frame"])["value"]


def test_scores_beside_other_rows_and_clips_are_those_of_a_row_alone(tmp_path):
    clips = [StoredSource(write_procedural_clip(tmp_path / str(i), i, 32, 3)) for i in (3, 4)]
    together = scores(("mean", "eaw"), tuple(clips), tmp_path / "together")
    alone = scores(("eaw",), (clips[1],), tmp_path / "alone")
    assert len(alone) > 50
    assert together[alone.index].equals(alone)
