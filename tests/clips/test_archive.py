"""Archives of clips: equal bytes for equal clips, and nothing but a clip comes out."""

from __future__ import annotations

import hashlib
import io
import os
import tarfile

import pytest

from rlbench.clips.archive import ArchiveError, clip_digests, pack_clip, unpack_clip
from rlbench.clips.stored import verify
from tests.conftest import write_noise


@pytest.fixture
def packed(clip_folder, tmp_path):
    """A clip as an archive, and its digests."""
    (clip_folder / "scene.txt").write_text("key\n")
    (clip_folder / ".hidden").write_text("not part of it")
    pack_clip(clip_folder, tmp_path / "a.tar")
    return tmp_path / "a.tar", clip_digests(clip_folder)


def add(file, name, content=b"", **fields):
    """Append a member to an archive."""
    entry = tarfile.TarInfo(name)
    entry.size = len(content)
    for key, value in fields.items():
        setattr(entry, key, value)
    with tarfile.open(file, "a") as archive:
        archive.addfile(entry, io.BytesIO(content))


def test_an_unpacked_clip_is_the_clip(packed, clip_folder, tmp_path):
    file, digests = packed
    header = unpack_clip(file, tmp_path / "out" / "noise", digests)
    assert header.name == "noise"
    assert verify(tmp_path / "out" / "noise") == []
    assert clip_digests(tmp_path / "out" / "noise") == digests
    assert (tmp_path / "out" / "noise" / "scene.txt").read_text() == "key\n"
    assert not (tmp_path / "out" / "noise" / ".hidden").exists()


def test_equal_clips_give_equal_archives(packed, clip_folder, tmp_path):
    for path in clip_folder.iterdir():
        os.utime(path, (1, 1))
        path.chmod(0o600)
    pack_clip(clip_folder, tmp_path / "b.tar")
    hashes = [hashlib.sha256((tmp_path / n).read_bytes()).digest() for n in ("a.tar", "b.tar")]
    assert hashes[0] == hashes[1]


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("../evil.exr", {}),
        ("/tmp/evil.exr", {}),
        ("folder/evil.exr", {}),
        ("evil.exr", {"type": tarfile.SYMTYPE, "linkname": "/etc/passwd"}),
        ("evil.exr", {"type": tarfile.LNKTYPE, "linkname": "clip.toml"}),
        ("evil.exr", {"type": tarfile.FIFOTYPE}),
        ("evil.exr", {"type": tarfile.DIRTYPE}),
        (".hidden.exr", {}),
        ("evil.sh", {}),
    ],
)
def test_a_member_that_is_no_file_of_a_clip_is_refused(packed, tmp_path, name, fields):
    file, digests = packed
    add(file, name, **fields)
    with pytest.raises(ArchiveError, match="which is no file of a clip"):
        unpack_clip(file, tmp_path / "out" / "noise", digests)
    assert list((tmp_path / "out").iterdir()) == []
    assert not (tmp_path / "evil.exr").exists()


def test_a_clip_with_other_pixels_leaves_nothing(packed, tmp_path):
    other = write_noise(tmp_path / "second" / "other")
    pack_clip(other, tmp_path / "b.tar")
    with pytest.raises(ArchiveError, match=r"has a clip with digest \w{12} \(path\), expected"):
        unpack_clip(tmp_path / "b.tar", tmp_path / "out" / "noise", packed[1])
    assert list((tmp_path / "out").iterdir()) == []


def test_a_clip_with_other_pools_is_refused(packed, tmp_path):
    with pytest.raises(ArchiveError, match="with pools path, expected path, restir"):
        unpack_clip(packed[0], tmp_path / "noise", {**packed[1], "restir": "0" * 32})


@pytest.mark.parametrize("cut", [0, 100, 5000])
def test_an_archive_that_was_cut_short_is_an_error(packed, tmp_path, cut):
    file, digests = packed
    file.write_bytes(file.read_bytes()[:cut])
    with pytest.raises((ArchiveError, OSError, ValueError)):
        unpack_clip(file, tmp_path / "out" / "noise", digests)
    assert not (tmp_path / "out" / "noise").exists()
