"""Formats: known names, former names, and messages about folders without a clip."""

from __future__ import annotations

import pytest

from rlbench.apps.dumps.importers import formats
from rlbench.errors import SourceError
from tests.apps.dumps.importers.sources import write_oidn


def test_an_unknown_layout_is_reported_with_the_known_ones(source):
    with pytest.raises(
        SourceError,
        match=r"no layout 'blend', .*; there are: blender, .*\. Did you mean 'blender'\?$",
    ):
        formats.find_sequences(source, "blend")


@pytest.mark.parametrize("format_", ["noisebase", "rl-path-tracing"])
def test_a_source_of_another_format_is_reported_with_the_expected_files(source, format_):
    with pytest.raises(SourceError, match="expected files such as .*; it holds: walk_0000_seed0"):
        formats.find_sequences(source, format_)


def test_two_clips_of_one_name_are_an_error(tmp_path):
    for folder in ("day", "day-walk"):
        write_oidn(tmp_path / folder, frames=1)
    for path in (tmp_path / "day-walk").iterdir():
        path.rename(path.with_name(path.name.replace("walk_", "")))
    with pytest.raises(SourceError, match="two clips named 'day-walk'; import .* separately"):
        formats.find_sequences(tmp_path, "oidn")


def test_a_name_in_the_source_does_not_leave_the_output(tmp_path):
    source = write_oidn(tmp_path / "source", frames=1)
    for path in list(source.iterdir()):
        path.rename(source / path.name.replace("walk_0000", ".."))
    (sequence,) = formats.find_sequences(source, "oidn")
    assert sequence.name == "source"  # dots are removed, and the folder's name is used


def test_frames_beyond_the_last_are_missing(source):
    with pytest.raises(
        SourceError, match="frames 1 to 4 are required and 2 of them are missing: 3, 4"
    ):
        formats.find_sequences(source, "oidn", (1, 5))
