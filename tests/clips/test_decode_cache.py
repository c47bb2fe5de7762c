"""The decode cache finds damaged files; the digest of a clip covers what decides pixels."""

from __future__ import annotations

import errno
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import torch

from rlbench.clips import decode_cache, digest, open_clip, write_header
from rlbench.clips.decode_cache import open_array, write_array
from rlbench.system import paths
from tests.clips.clip_folders import HEADER, edit, touch_up


def _old_file() -> bytes:
    np.save(content := BytesIO(), np.zeros((3, 5, 7), np.float32))
    return content.getvalue()  # as it was before there were checksums


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "zeros": lambda content: bytes(len(content)),
    "zeros for values": lambda content: content[:128] + bytes(len(content) - 148) + content[-20:],
    "a flipped bit": lambda content: content[:200] + bytes([content[200] ^ 1]) + content[201:],
    "cut": lambda content: content[:150],
    "a lost end": lambda content: content[:-1],
    "empty": lambda content: b"",
    "longer": lambda content: content + b"x",
    "without a checksum": lambda content: _old_file(),
}

OTHERS = {"shape": np.zeros((1, 1, 1), np.float16), "type": np.zeros((3, 5, 7))}


@pytest.mark.parametrize("kind", [*DAMAGE, *OTHERS])
def test_a_damaged_file_is_decoded_again(folder, kind):
    before = open_clip(folder).frame(1)
    files = sorted(paths.decoded_folder().rglob("*.npy"))
    assert files
    for path in files:
        if kind in OTHERS:
            write_array(path, OTHERS[kind])
        else:
            path.write_bytes(DAMAGE[kind](path.read_bytes()))
    after = open_clip(folder).frame(1)
    assert torch.equal(before.pool.radiance, after.pool.radiance)
    assert torch.equal(before.reference.half_a, after.reference.half_a)
    for name in ("depth", "albedo"):
        assert torch.equal(before.gbuffer.buffers[name], after.gbuffer.buffers[name])


def test_an_image_is_stored_in_its_own_type_whatever_is_decoded_with_it(folder):
    """Else two processes would replace each other's files by files of another size."""
    stored = []
    for inputs in ({"normal"}, {"normal", "depth"}):
        open_clip(folder, frozenset(inputs)).frame(0)
        (file,) = paths.decoded_folder().rglob("normal.0000.npy")
        stored.append(file.read_bytes())
        file.unlink()
        for depth in paths.decoded_folder().rglob("depth.0000.npy"):
            assert np.load(depth).dtype == np.float32
    assert stored[0] == stored[1]
    assert np.load(BytesIO(stored[0])).dtype == np.float16


def test_an_intact_file_is_hashed_once_per_process(folder, monkeypatch):
    open_clip(folder).frame(0)
    open_clip(folder).frame(0)
    monkeypatch.setattr(decode_cache, "_checksum", None)  # hashing would now be an error
    monkeypatch.setattr(decode_cache, "read_channels", None)  # and so would decoding
    open_clip(folder).frame(0)


def test_a_full_disk_leaves_no_file_and_says_so(folder, monkeypatch):
    def fail(*_args: object, **_options: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array", fail)
    with pytest.raises(paths.WriteError, match=r"npy cannot be written .*bytes free"):
        open_clip(folder).frame(0)
    assert [p for p in paths.decoded_folder().rglob("*") if "npy" in p.name] == []


def test_an_array_comes_back_as_a_memory_map(tmp_path):
    values = np.arange(24, dtype=np.float16).reshape(2, 3, 4)
    write_array(tmp_path / "a.npy", values)
    array = open_array(tmp_path / "a.npy", (2, 3, 4))
    assert isinstance(array, np.memmap)
    np.testing.assert_array_equal(array, values)


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
