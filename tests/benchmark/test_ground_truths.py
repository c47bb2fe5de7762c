"""What metrics derive from a reference is made once for all cells of a clip."""

from __future__ import annotations

import pickle

import pytest

from metrics.metric import Metric
from rlbench.benchmark import ground_truths
from rlbench.benchmark.ground_truths import KeptGroundTruths, ground_truth
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size


@pytest.fixture
def clip():
    return procedural_clip(3, Size(1, 16, 16), 2, 4)


def test_every_cell_of_a_clip_gets_the_same_ground_truth(clip):
    kept = KeptGroundTruths(Metric)
    first, second = ([kept.of_clip(clip)(frame) for frame in clip] for _ in range(2))
    assert [a is b for a, b in zip(first, second, strict=True)] == [True, True]
    assert (first[1].motion == ground_truth(Metric, clip.frames[1]).motion).all()


def test_the_ground_truth_of_the_clip_before_is_forgotten(clip):
    kept, other = KeptGroundTruths(Metric), procedural_clip(4, Size(1, 16, 16), 2, 4)
    first = kept.of_clip(clip)(clip.frames[0])
    of_other = kept.of_clip(other)(other.frames[0])
    assert (of_other.half_a == other.frames[0].reference.half_a).all()
    assert kept.of_clip(clip)(clip.frames[0]) is not first


def test_that_of_a_large_clip_is_not_kept(clip, monkeypatch):
    monkeypatch.setattr(ground_truths, "MAX_PIXELS", 511)
    truth_of = KeptGroundTruths(Metric).of_clip(clip)
    assert truth_of(clip.frames[0]) is not truth_of(clip.frames[0])


def test_a_copy_for_another_process_is_empty(clip):
    kept = KeptGroundTruths(Metric)
    kept.of_clip(clip)(clip.frames[0])
    assert len(pickle.dumps(kept)) < 1000
