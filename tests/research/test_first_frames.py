"""First frames: a method that starts anew gives the first image of a clip, whatever came before."""

from __future__ import annotations

import pytest
import torch

from research.first_frames import STEPS, start_anew
from research.memory_constants import constants
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.run import run_clip


@pytest.mark.parametrize("name", ["oidn", "accumulate/fast"])
def test_each_frame_starts_anew(name):
    method, clip = registry.load_method(name), procedural_clip(frames=2)
    first, second = run_clip(method, clip, spp=1.0)
    frames = list(clip)
    assert torch.equal(start_anew(method, frames[0], 1.0), first.image)
    is_recurrent = method.traits.temporal
    assert torch.equal(start_anew(method, frames[1], 1.0), second.image) != is_recurrent


def test_the_first_step_limits_no_firefly():
    frame = next(iter(procedural_clip(frames=1)))
    frame.pool.radiance[0, :, :, 20, 20] = 6e4  # among values of about 1
    method = registry.load_method("oidn")
    limited = start_anew(method, frame, 1.0)
    with constants(STEPS[0].constants):
        assert not torch.equal(start_anew(method, frame, 1.0), limited)
