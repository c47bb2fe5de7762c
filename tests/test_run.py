"""Running a clip: gradients only where they are wanted."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch

from rlbench.clips.procedural.clip import procedural
from rlbench.frames import Size
from rlbench.run import run_clip, unroll
from tests.test_page import Diary

SIZE = Size(1, 9, 11)


@pytest.mark.parametrize(("run", "traced"), [(unroll, True), (run_clip, False)])
def test_only_training_keeps_gradients(run, traced):
    weight = torch.ones((), requires_grad=True)

    @dataclass(frozen=True)
    class Scaled(Diary):
        def denoise(self, gbuffer, samples, state):
            return samples.mean * weight, state

    shown = next(iter(run(Scaled(), procedural(size=SIZE, frames=1), 1.0)))
    assert shown.image.requires_grad is traced


def test_runs_that_take_turns_leave_gradients_as_they_were():
    clips = [procedural(seed, SIZE, frames=2) for seed in (0, 1)]
    for _ in zip(*(run_clip(Diary(), clip, 1.0) for clip in clips), strict=True):
        assert not torch.is_inference_mode_enabled()
    assert not torch.is_inference_mode_enabled()
