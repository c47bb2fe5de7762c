"""Limits for untrusted files: folders and links."""

from __future__ import annotations

import pytest

from rlbench.clips.importers import formats
from rlbench.clips.importers.sequence import SourceError


def test_no_folder_is_an_error(tmp_path):
    with pytest.raises(SourceError, match="no folder .*nowhere"):
        formats.find_sequences(tmp_path / "nowhere", "oidn")


@pytest.mark.parametrize("format_", list(formats.FORMATS))
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_link_that_leaves_the_source_is_not_followed(tmp_path, format_, kind):
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "key").write_text("!")
    (tmp_path / "source").mkdir()
    target = tmp_path / "secret" / ("key" if kind == "file" else "")
    (tmp_path / "source" / "frame0000.zip").symlink_to(target)
    with pytest.raises(SourceError, match=r"frame0000\.zip is a link that leaves"):
        formats.find_sequences(tmp_path / "source", format_)


def test_a_link_inside_the_source_is_followed(source):
    (source / "walk_0003_seed0_0001spp.hdr.exr").symlink_to("walk_0000_seed0_0001spp.hdr.exr")
    assert formats.find_sequences(source, "oidn", (0, 3))[0].numbers == (0, 1, 2)
