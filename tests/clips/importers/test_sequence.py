"""Names of clips and ranges of frames."""

from __future__ import annotations

import pytest

from rlbench.clips.importers.sequence import SourceError, clip_name, parse_frame_range


@pytest.mark.parametrize("name", ["..", ".hidden", "a/b", "-o", "", "a\nb"])
def test_a_name_that_is_not_safe_as_a_folder_name_is_an_error(name):
    with pytest.raises(SourceError, match="cannot be a clip's name"):
        clip_name(name)


@pytest.mark.parametrize("text", ["5", "3:3", "5:2", "a:b", "-1:3"])
def test_an_invalid_range_of_frames_is_an_error(text):
    with pytest.raises(SourceError, match="FIRST:END"):
        parse_frame_range(text)
