"""Other constants of the memory, and first frames of a method that starts anew."""

from __future__ import annotations

import pytest
import torch

from research.first_frames import STEPS, start_anew
from research.memory_constants import AS_THEY_ARE, TABLES, constants
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.run import run_clip

CHANGES = {name: change for table in TABLES.values() for name, change in table.items()}


@pytest.mark.parametrize("change", [name for name in CHANGES if name != AS_THEY_ARE])
def test_a_change_changes_the_image_until_its_block_ends(change):
    def last_image():
        method = registry.load_method("accumulate/fast")
        *_, last = run_clip(method, procedural_clip(frames=3), spp=1.0)
        return last.image

    before = last_image()
    with constants(CHANGES[change]):
        assert not torch.equal(last_image(), before)
    assert torch.equal(last_image(), before)


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
