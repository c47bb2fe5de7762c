"""Folders that a user names: with clips, with frames to import, empty, or missing."""

from __future__ import annotations

import pytest

from rlbench.clips.clip_folders import find_all_clips
from rlbench.clips.header import ClipError
from tests.conftest import write_noise


def test_clips_of_several_folders_are_found_in_order(tmp_path):
    clips = [write_noise(tmp_path / "a" / name) for name in ("attic", "foyer")]
    clips.append(write_noise(tmp_path / "cellar"))
    assert find_all_clips([tmp_path / "a", tmp_path / "cellar"]) == clips


def test_a_folder_with_clips_further_down_names_the_folders_that_hold_them(tmp_path):
    for renderer in ("falcor", "unreal"):
        write_noise(tmp_path / "clips" / renderer / "attic")
    with pytest.raises(ClipError, match=r"further down.*: \S+/clips/falcor, \S+/clips/unreal$"):
        find_all_clips([tmp_path / "clips"])


def test_a_folder_without_anything_says_what_a_clip_is(tmp_path):
    with pytest.raises(
        ClipError, match="no clip in .*; a clip is a folder that contains clip.toml"
    ):
        find_all_clips([tmp_path])


def test_a_file_in_place_of_a_folder_is_named(tmp_path):
    (tmp_path / "a.exr").touch()
    with pytest.raises(ClipError, match="a.exr is a file. Name a folder"):
        find_all_clips([tmp_path / "a.exr"])
