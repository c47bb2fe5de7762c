"""The map that is found for a frame by itself is better, where a better one is known."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from methods.ours.experiments.oracle_map import ceiling, improved
from methods.ours.frame_problem import FrameProblem
from methods.ours.method import build
from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Frame, Size, StoredPool
from tests.conftest import write_noise

SIZE = Size(1, 32, 48)
NOISY = 24  # columns from here on are noisy


def turns(count: int) -> list[FrameProblem]:
    """One frame whose left half has no noise, sold in several orders."""
    method = build("", torch.device("cpu"), None)
    frame = next(iter(procedural(seed=2, size=SIZE, frames=1)))
    assert isinstance(frame.pool, StoredPool)
    radiance = frame.pool.radiance.clone()
    radiance[..., :NOISY] = frame.reference.mean[:, None, ..., :NOISY]
    orders = [radiance[:, torch.arange(8).roll(step)] for step in range(count)]
    frames = [replace(frame, pool=StoredPool(each, (7 + i,))) for i, each in enumerate(orders)]
    return [_turn(method, each) for each in frames]


def _turn(method, frame: Frame) -> FrameProblem:
    return FrameProblem(method, frame, frame.gbuffer, method.start(SIZE), 1.0)


@pytest.mark.parametrize("index", [-1, 3])
def test_a_frame_that_the_clip_does_not_have_is_refused(index, tmp_path):
    folder = write_noise(tmp_path / "noise", frames=3, h=32, w=48)
    with pytest.raises(ValueError, match=f"frame {index} asked for, .* has 0 to 2"):
        ceiling(build("", torch.device("cpu"), None), folder, 1.0, index, steps=1)


def test_a_turn_that_was_tried_can_be_improved():
    tried = turns(1)
    tried[0].rollout(torch.zeros(1, 1, 1, *SIZE[1:]))
    assert improved(tried, torch.zeros(1, 1, *SIZE[1:]), steps=1).isfinite().all()


def test_it_samples_where_there_is_noise_and_errs_less():
    *seen, a, b, c, d = turns(8)
    uniform = torch.zeros(1, 1, *SIZE[1:])
    found = improved(seen, uniform, steps=80)
    assert found.abs().max() <= 1
    assert found[..., NOISY:].mean() > found[..., :NOISY].mean() + 0.5
    maps = torch.stack((uniform, found))
    errors = sum(held.rollout(maps).errors.mean((1, 2, 3, 4)) for held in (a, b, c, d))
    assert errors[1] < errors[0]  # of one order alone, that is chance
