"""The digest of a clip: it covers what decides pixels, and unchanged files are not read again."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rlbench.clips import digest, open_clip, write_header
from tests.clips.clip_folders import HEADER, edit, touch_up


def test_a_changed_pixel_changes_the_digest_and_is_decoded_again(folder):
    open_clip(folder).frame(1)
    before = open_clip(folder).digest
    touch_up(folder / "referenceA.0001.exr", "G", 7.0)
    assert open_clip(folder).digest != before
    assert open_clip(folder).frame(1).reference.half_a[0, 1, 1, 2] == 3.5  # the exposure is 0.5


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"sample_ms": 3.0}, True),
        ({"device": "another machine"}, True),
        ({"exposure": 2.0}, False),
        ({"name": "another name"}, False),
        ({"limitations": ("halves",)}, False),
    ],
)
def test_the_digest_covers_the_fields_that_decide_pixels(folder, change, same):
    before = open_clip(folder).digest
    write_header(folder, replace(HEADER, **change))
    assert (open_clip(folder).digest == before) is same


def test_a_clip_has_the_digest_that_it_had_before_there_were_cuts_and_limitations(folder):
    before = open_clip(folder).digest
    edit(folder, "cuts = []\n", "")
    assert open_clip(folder).digest == before
    assert "lacks" not in HEADER.digest_fields("path")


def test_files_that_did_not_change_are_hashed_once_and_a_moved_clip_keeps_its_digest(
    folder, monkeypatch
):
    before = open_clip(folder).digest
    with monkeypatch.context() as patch:
        patch.setattr(digest.hashlib, "file_digest", None)
        assert open_clip(folder).digest == before  # hashing a file would now be an error
    assert open_clip(folder.rename(folder.with_name("moved"))).digest == before
