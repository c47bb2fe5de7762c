"""The map that is optimised for one frame is better, where a better one is known."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from methods.ours.method import build
from methods.ours.problem import FrameProblem
from research.oracle_map import OracleResult, _append, optimize_map, score_frame
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size, StoredPool
from tests.conftest import write_noise

SIZE = Size(1, 32, 48)
NOISY = 24  # columns from here on are noisy


def problems(count: int) -> list[FrameProblem]:
    """One frame whose left half has no noise, with its samples in several orders."""
    method = build("", torch.device("cpu"), None)
    frame = next(iter(procedural_clip(seed=2, size=SIZE, frames=1)))
    assert isinstance(frame.pool, StoredPool)
    radiance = frame.pool.radiance.clone()
    radiance[..., :NOISY] = frame.reference.mean[:, None, ..., :NOISY]
    orders = [radiance[:, torch.arange(8).roll(step)] for step in range(count)]
    frames = [replace(frame, pool=StoredPool(order, (7 + i,))) for i, order in enumerate(orders)]
    state = method.start(SIZE)
    return [FrameProblem(method, each, each.gbuffer, state, 1.0) for each in frames]


@pytest.mark.parametrize("index", [-1, 3])
def test_a_frame_that_the_clip_does_not_have_is_refused(index, tmp_path):
    folder = write_noise(tmp_path / "noise", frames=3, h=32, w=48)
    with pytest.raises(ValueError, match=f"--frame {index}: .* has frames 0 to 2"):
        score_frame(build("", torch.device("cpu"), None), folder, 1.0, index, steps=1)


def test_a_problem_that_was_rolled_out_is_optimised_towards_its_noise():
    (problem,) = problems(1)
    problem.rollout(torch.zeros(1, 1, 1, *SIZE[1:]))
    best = optimize_map([problem], torch.zeros(1, 1, *SIZE[1:]), steps=8)
    assert best[..., NOISY:].mean() > best[..., :NOISY].mean()


@pytest.mark.slow
def test_the_optimised_map_samples_where_there_is_noise_and_lowers_the_error():
    *trained, a, b, c, d = problems(8)
    uniform = torch.zeros(1, 1, *SIZE[1:])
    best = optimize_map(trained, uniform, steps=80)
    assert best.abs().max() <= 1
    assert best[..., NOISY:].mean() > best[..., :NOISY].mean() + 0.5
    maps = torch.stack((uniform, best))
    errors = sum(test.rollout(maps).errors.mean((1, 2, 3, 4)) for test in (a, b, c, d))
    assert errors[1] < errors[0]  # on a single order this could be chance


def test_results_are_appended_below_one_header(tmp_path: Path):
    for frame in (1, 2):
        _append(tmp_path / "oracle.csv", OracleResult("hall", 2.0, frame, 20.0, 21.0, 22.0))
    with (tmp_path / "oracle.csv").open(newline="") as file:
        assert [row["frame"] for row in csv.DictReader(file)] == ["1", "2"]
