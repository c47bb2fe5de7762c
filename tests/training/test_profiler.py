"""Where the time of a training goes, told part by part."""

from __future__ import annotations

import pytest

from rlbench import registry
from rlbench.training.config import TrainingConfig
from rlbench.training.profiler import PARTS, main, profile
from tests.conftest import write_noise
from tests.learning_plugin import write_learner


@pytest.fixture
def clip(tmp_path):
    registry.use_plugin(write_learner(tmp_path))
    return write_noise(tmp_path / "noise", h=24, w=24)


def test_every_part_of_a_step_is_told_and_together_they_are_nearly_all_of_it(clip):
    found = profile("blur", [clip], TrainingConfig(frames=30, crop=16, length=3))
    parts = {part.told: part.seconds for part in found.parts}
    own = set(PARTS.values()) - {"of that, L1 and MS-SSIM"}  # blur has a loss of its own
    assert own <= set(parts)
    assert found.frames == 30
    assert 0.8 * found.seconds < sum(parts[told] for told in own) <= found.seconds * 1.001


def test_the_longest_functions_of_the_method_are_told(clip):
    words = ("blur", "--frames", "6", "--crop", "16", "--threads", "1", "--clips", str(clip))
    text = main(words)
    assert text.startswith("3 frames in ")  # the clip has no more
    assert "| `blur.py` losses |" in text
