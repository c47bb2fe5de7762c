"""The profile of a training run: its parts, and the functions of the method."""

from __future__ import annotations

import pytest

from research.profile_training import PARTS, main, profile
from rlbench import registry
from rlbench.training.task import TrainingConfig
from tests.conftest import write_noise
from tests.learning_plugin import write_learner


@pytest.fixture
def clip(tmp_path):
    registry.use_plugin(write_learner(tmp_path))
    return write_noise(tmp_path / "noise", h=24, w=24)


def test_every_part_of_a_step_is_listed_and_together_they_are_nearly_all_of_it(clip):
    result = profile("blur", [clip], TrainingConfig(frames=30, crop=16, sequence_length=3))
    parts = {part.label: part.seconds for part in result.parts}
    expected = set(PARTS.values()) - {"of that, L1 and MS-SSIM"}  # blur has a loss of its own
    assert expected <= set(parts)
    assert result.frames == 30
    total = sum(parts[label] for label in expected)
    # a busy machine may interrupt the profiler between a part and the whole
    assert 0.8 * result.seconds < total <= result.seconds * 1.1


def test_the_longest_functions_of_the_method_are_listed(clip):
    argv = ("blur", "--frames", "6", "--crop", "16", "--threads", "1", "--clips", str(clip))
    text = main(argv)
    assert text.startswith("3 frames in ")  # the clip has no more
    assert "| `blur.py` losses |" in text
