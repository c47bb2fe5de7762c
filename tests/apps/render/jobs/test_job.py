"""Render jobs: missing frames and content keys."""

from dataclasses import replace

import pytest

from rlbench.apps.render.jobs.render_clips import render_clip
from rlbench.clips.presets import PRESETS
from tests.apps.render.jobs.test_render_clips import job
from tests.apps.render.small_scenes import room


@pytest.fixture
def clip(llvm, tmp_path):
    render_clip(job(tmp_path / "room"))
    return tmp_path / "room"


def test_frames_of_a_changed_scene_count_as_missing(clip):
    assert job(clip).missing_frames == []
    assert job(clip, replace(room(), max_depth=3)).missing_frames == [0, 1, 2]


def test_content_keys_of_existing_clips_have_not_changed():
    # as in scene.txt of clips that were rendered before rounds and caps existed
    assert job("a", preset=PRESETS["mini"]).content_key.endswith(
        " 192x192 8 frames 8 + 2 x 64 spp\n"
    )
    assert job("a", preset=PRESETS["train"]).content_key.endswith(
        " 160x160 5 frames 8 + 2 x 64 spp\n"
    )
