"""Arrays of a clip folder."""

from __future__ import annotations

import pytest
import torch

from rlbench.checks.lint.clip_arrays import read_clip_arrays
from rlbench.clips.stored import ClipError, open_clip


def test_arrays_equal_those_of_the_clip_reader(arrays, folder):
    frame = open_clip(folder, seed=3).frame(2)
    read = read_clip_arrays(folder)
    assert torch.equal(read.gbuffer["motion"][2, None], frame.gbuffer.motion)
    assert torch.equal(read.reference[2, None] * 0.5, frame.reference.mean)


def test_only_the_requested_frames_are_read(folder):
    assert len(read_clip_arrays(folder, 2)) == 2


def test_a_folder_that_is_no_clip_is_an_error(tmp_path):
    with pytest.raises(ClipError, match="no clip folder"):
        read_clip_arrays(tmp_path / "nowhere")
