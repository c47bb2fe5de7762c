"""Other constants of the memory: each changes images while it holds, and nothing afterwards."""

from __future__ import annotations

import pytest
import torch

from research.memory_constants import AS_THEY_ARE, TABLES, constants
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.run import run_clip


def last_image(name: str = "accumulate/fast") -> torch.Tensor:
    *_, last = run_clip(registry.load_method(name), procedural_clip(frames=3), spp=1.0)
    return last.image


CHANGES = {name: change for table in TABLES.values() for name, change in table.items()}


@pytest.mark.parametrize("change", [name for name in CHANGES if name != AS_THEY_ARE])
def test_a_change_changes_the_image_until_its_block_ends(change):
    before = last_image()
    with constants(CHANGES[change]):
        assert not torch.equal(last_image(), before)
    assert torch.equal(last_image(), before)
